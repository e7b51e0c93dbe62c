"""Anchors that a frame adds (`core.train.later_frame.added_anchors`): decoded, differentiated, and a step of Adam.

All their numbers are trained: F features, 3K offsets, 6 log-scales and the place, in the steps that they are rounded
to. There are few of them, so that the network is worked out by every Gaussian, and nothing is folded.
"""

from __future__ import annotations

import warp as wp

from streamlod.core.render.warp.kernels.rules import Cloud
from streamlod.core.scene.anchors import SCALINGS
from streamlod.core.scene.gaussians import MAX_LOG_SCALE
from streamlod.core.train.engine.warp.kernels.adam import sound, stepped
from streamlod.core.train.engine.warp.kernels.decode import bias_of, by_outputs, by_unit, with_unit, write
from streamlod.core.train.engine.warp.kernels.layout import (
    HIDDEN_UNITS,
    MEAN_WEIGHT,
    NEW_INVERSE_SECOND,
    NEW_RATES,
    AnchorBase,
    Decoders,
    seen_from,
)

SIZES = wp.constant(SCALINGS)
LARGEST_SIZE = wp.constant(MAX_LOG_SCALE)
# What a Gaussian asks of its anchor: hidden units, its offset, both halves of the log-scales, the place.
TO_OFFSET, TO_SIZES, TO_PLACE = wp.constant(32), wp.constant(35), wp.constant(41)
PULLS = 44


@wp.struct
class Added:
    """M anchors, a capacity.

    Attributes:
        count: [1] that exist.
        node: [M] world positions of their grid nodes.
        width: [M,F+3K+9] of a step of each number.
        weight: [F,32] of the network's features. bias: [32].
    """

    count: wp.array[int]
    node: wp.array[wp.vec3]
    width: wp.array2d[float]
    weight: wp.array2d[float]
    bias: wp.array[float]


@wp.func
def rounded(values: wp.array2d[float], added: Added, m: int, n: int) -> float:
    """A number as it will be sent."""
    return wp.rint(values[m, n]) * added.width[m, n]


@wp.func
def three(values: wp.array2d[float], added: Added, m: int, n: int) -> wp.vec3:
    """Three numbers, as they will be sent."""
    return wp.vec3(rounded(values, added, m, n), rounded(values, added, m, n + 1), rounded(values, added, m, n + 2))


@wp.func
def size_of(logarithms: wp.vec3) -> wp.vec3:
    """Exponentials, which stay finite."""
    held = wp.min(wp.max(logarithms, wp.vec3(-LARGEST_SIZE)), wp.vec3(LARGEST_SIZE))
    return wp.vec3(wp.exp(held[0]), wp.exp(held[1]), wp.exp(held[2]))


@wp.func
def within(logarithms: wp.vec3, slope: wp.vec3) -> wp.vec3:
    """`slope` where the exponentials are not held."""
    return wp.vec3(
        wp.where(wp.abs(logarithms[0]) <= LARGEST_SIZE, slope[0], 0.0),
        wp.where(wp.abs(logarithms[1]) <= LARGEST_SIZE, slope[1], 0.0),
        wp.where(wp.abs(logarithms[2]) <= LARGEST_SIZE, slope[2], 0.0),
    )


@wp.func
def hidden_of(values: wp.array2d[float], added: Added, decoders: Decoders, m: int, j: int, view: wp.vec4) -> float:
    """One hidden unit before activation."""
    h = added.bias[j] + wp.dot(decoders.view[j], view)
    for f in range(added.weight.shape[0]):
        h += added.weight[f, j] * rounded(values, added, m, f)
    return h


@wp.kernel(enable_backward=False, grid_stride=False)
def decode_added(
    values: wp.array2d[float],
    base: AnchorBase,
    added: Added,
    decoders: Decoders,
    chosen: wp.array[int],
    cloud: Cloud,
    gaussians: wp.array[int],
) -> None:
    """Grid (D, M, K), D the views if the network sees them, else 1; Gaussians behind those of the anchors of `base`.

    Args:
        values: [M,F+3K+9] in steps. chosen: [V] camera of each view. cloud: out, [D,(N+M)*K].
        gaussians: out, [1] that there are with those of `base`.
    """
    d, m, k = wp.tid()
    slots = decoders.opacity.shape[1]
    if d == 0 and m == 0 and k == 0:
        gaussians[0] = (base.count[0] + added.count[0]) * slots
    if m >= added.count[0]:
        return
    offsets = added.weight.shape[0]
    sizes = offsets + 3 * slots
    place = added.node[m] + three(values, added, m, sizes + SIZES)
    view = seen_from(decoders, place, chosen[d])
    outputs = bias_of(decoders, k)
    for j in range(HIDDEN_UNITS):
        h = wp.max(hidden_of(values, added, decoders, m, j, view), 0.0)
        outputs = with_unit(outputs, decoders, j, k, h)
    offset = three(values, added, m, offsets + 3 * k)
    i = (base.count[0] + m) * slots + k
    mean = place + wp.cw_mul(offset, size_of(three(values, added, m, sizes)))
    write(cloud, d, i, mean, size_of(three(values, added, m, sizes + 3)), outputs)


@wp.kernel(enable_backward=False, grid_stride=False)
def differentiate_added(
    values: wp.array2d[float],
    base: AnchorBase,
    added: Added,
    decoders: Decoders,
    chosen: wp.array[int],
    cloud: Cloud,
    by: Cloud,
    pulls: wp.array3d[float],
) -> None:
    """Grid (M, K); gradients go straight through the rounding.

    Args:
        values, base, added, decoders, chosen, cloud: as for `decode_added`. by: [D,(N+M)*K] the gradient by `cloud`.
        pulls: out, [K,M,44] what each Gaussian asks of its anchor.
    """
    m, k = wp.tid()
    if m >= added.count[0]:
        return
    slots = decoders.opacity.shape[1]
    offsets = added.weight.shape[0]
    sizes = offsets + 3 * slots
    place = added.node[m] + three(values, added, m, sizes + SIZES)
    offset = three(values, added, m, offsets + 3 * k)
    spread = three(values, added, m, sizes)
    wide = three(values, added, m, sizes + 3)
    i = (base.count[0] + m) * slots + k
    for j in range(HIDDEN_UNITS):
        pulls[k, m, j] = 0.0
    to_mean = wp.vec3(0.0, 0.0, 0.0)
    to_wide = wp.vec3(0.0, 0.0, 0.0)
    for d in range(cloud.means.shape[0]):
        view = seen_from(decoders, place, chosen[d])
        slopes = by_outputs(cloud, by, d, i, size_of(wide))
        to_mean += by.means[d, i]
        to_wide += wp.cw_mul(by.scales[d, i], cloud.scales[d, i])
        for j in range(HIDDEN_UNITS):
            if hidden_of(values, added, decoders, m, j, view) > 0.0:
                pulls[k, m, j] += by_unit(slopes, decoders, j, k)
    moved = wp.cw_mul(to_mean, size_of(spread))
    to_spread = within(spread, wp.cw_mul(moved, offset))
    to_wide = within(wide, to_wide)
    for c in range(3):
        pulls[k, m, TO_OFFSET + c] = moved[c]
        pulls[k, m, TO_SIZES + c] = to_spread[c]
        pulls[k, m, TO_SIZES + 3 + c] = to_wide[c]
        pulls[k, m, TO_PLACE + c] = to_mean[c]


@wp.func
def pull_of(added: Added, pulls: wp.array3d[float], m: int, n: int) -> float:
    """The gradient by a number in steps, of all Gaussians of its anchor."""
    slots = pulls.shape[0]
    offsets = added.weight.shape[0]
    sizes = offsets + 3 * slots
    pull = float(0.0)
    if n < offsets:
        for k in range(slots):
            for j in range(HIDDEN_UNITS):
                pull += pulls[k, m, j] * added.weight[n, j]
    elif n < sizes:
        pull = pulls[(n - offsets) // 3, m, TO_OFFSET + (n - offsets) % 3]
    else:
        for k in range(slots):
            pull += pulls[k, m, TO_SIZES + n - sizes]  # the place follows the sizes in both
    return pull * added.width[m, n]


@wp.kernel(enable_backward=False, grid_stride=False)
def adam_added(
    added: Added,
    pulls: wp.array3d[float],
    told: wp.array[float],
    first: wp.array2d[float],
    second: wp.array2d[float],
    values: wp.array2d[float],
    mean: wp.array2d[float],
    broken: wp.array[int],
) -> None:
    """Grid (M, F+3K+9): as `kernels.adam.adam`, from what Gaussians ask."""
    m, n = wp.tid()
    if m >= added.count[0]:
        return
    g = sound(pull_of(added, pulls, m, n), broken)
    sizes = added.weight.shape[0] + 3 * pulls.shape[0]
    kind = int(n >= added.weight.shape[0]) + int(n >= sizes) + int(n >= sizes + SIZES)
    rate = told[NEW_RATES + kind]
    now = stepped(g, first[m, n], second[m, n], values[m, n], rate, told[NEW_INVERSE_SECOND], told)
    first[m, n] = now[0]
    second[m, n] = now[1]
    values[m, n] = now[2]
    mean[m, n] = mean[m, n] + told[MEAN_WEIGHT] * (now[2] - mean[m, n])
