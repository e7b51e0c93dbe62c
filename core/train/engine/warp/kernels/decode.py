"""Integers to Gaussians (`core.train.field.decode`), and the derivative by the numbers that are trained.

A thread is one Gaussian. Hidden units are worked out one after the other and never kept, which needs no array in a
thread; both layers of the network are passes over weights that all threads share.
"""

from __future__ import annotations

import warp as wp

from streamlod.core.render.warp.kernels.rules import Cloud
from streamlod.core.train.engine.warp.kernels.layout import (
    HIDDEN_UNITS,
    LATENT_COUNT,
    NUMBERS,
    SUM_LATENTS,
    SUM_POSITIONS,
    AnchorBase,
    Decoders,
    dead_zone,
    going,
    hidden_unit,
    integers,
    seen_from,
    vec12,
)
from streamlod.core.train.engine.warp.kernels.rate import quantised


@wp.func
def sigmoid(x: float) -> float:
    """1 / (1 + exp(-x))."""
    return 1.0 / (1.0 + wp.exp(-x))


@wp.func
def sigmoids(x: wp.vec3) -> wp.vec3:
    """`sigmoid` of each."""
    return wp.vec3(sigmoid(x[0]), sigmoid(x[1]), sigmoid(x[2]))


@wp.struct
class Outputs:
    """The network's outputs for a Gaussian before activation, or a loss's gradient by them."""

    opacity: float
    colour: wp.vec3
    scale: wp.vec3
    turn: wp.vec4


@wp.func
def bias_of(decoders: Decoders, k: int) -> Outputs:
    """The outputs without any hidden unit."""
    outputs = Outputs()
    outputs.opacity = decoders.opacity[HIDDEN_UNITS, k]
    outputs.colour = decoders.colour[HIDDEN_UNITS, k]
    outputs.scale = decoders.scale[HIDDEN_UNITS, k]
    outputs.turn = decoders.rotation[HIDDEN_UNITS, k]
    return outputs


@wp.func
def with_unit(outputs: Outputs, decoders: Decoders, j: int, k: int, h: float) -> Outputs:
    """The outputs with hidden unit j, whose value is `h`."""
    more = Outputs()
    more.opacity = outputs.opacity + decoders.opacity[j, k] * h
    more.colour = outputs.colour + decoders.colour[j, k] * h
    more.scale = outputs.scale + decoders.scale[j, k] * h
    more.turn = outputs.turn + decoders.rotation[j, k] * h
    return more


@wp.func
def write(cloud: Cloud, d: int, i: int, mean: wp.vec3, size: wp.vec3, outputs: Outputs) -> None:
    """Put a Gaussian at `mean`, at most of `size`, into the cloud."""
    cloud.means[d, i] = mean
    cloud.quaternions[d, i] = outputs.turn + wp.vec4(1.0, 0.0, 0.0, 0.0)
    cloud.scales[d, i] = wp.cw_mul(size, sigmoids(outputs.scale))
    cloud.opacities[d, i] = wp.tanh(outputs.opacity)
    cloud.colours[d, i] = sigmoids(outputs.colour)


@wp.func
def by_outputs(cloud: Cloud, by: Cloud, d: int, i: int, size: wp.vec3) -> Outputs:
    """The gradient by a Gaussian's outputs, of that by its numbers; `size` as for `write`."""
    one = wp.vec3(1.0, 1.0, 1.0)
    shown = cloud.opacities[d, i]
    tint = cloud.colours[d, i]
    scale = cloud.scales[d, i]
    slopes = Outputs()
    slopes.opacity = by.opacities[d, i] * (1.0 - shown * shown)
    slopes.colour = wp.cw_mul(by.colours[d, i], wp.cw_mul(tint, one - tint))
    slopes.scale = wp.cw_mul(wp.cw_mul(by.scales[d, i], scale), one - wp.cw_div(scale, size))
    slopes.turn = by.quaternions[d, i]
    return slopes


@wp.func
def by_unit(slopes: Outputs, decoders: Decoders, j: int, k: int) -> float:
    """The gradient by hidden unit j."""
    pull = decoders.opacity[j, k] * slopes.opacity + wp.dot(decoders.colour[j, k], slopes.colour)
    return pull + wp.dot(decoders.scale[j, k], slopes.scale) + wp.dot(decoders.rotation[j, k], slopes.turn)


@wp.kernel(enable_backward=False, grid_stride=False)
def decode(
    values: wp.array[float],
    base: AnchorBase,
    decoders: Decoders,
    chosen: wp.array[int],
    cloud: Cloud,
    steps: wp.array[wp.vec3],
    rows: wp.array[wp.vec2],
    totals: wp.array[float],
) -> None:
    """Grid (D, N, K), D the views if the network sees them, else 1.

    Args:
        values: [N*27] numbers of the anchors. chosen: [V] camera of each view.
        cloud: out, [D,N*K]. steps: out, [N] how far each anchor goes.
        rows: out, [N] sums of the quantised magnitudes of an anchor's latents and steps; totals: in and out, of all.
    """
    d, a, k = wp.tid()
    if a >= base.count[0]:
        return
    z = integers(values, a * NUMBERS)
    far = integers(values, a * NUMBERS + 12)
    go = going(values, base, a)
    place = base.node[a] + wp.vec3(dead_zone(go[0]), dead_zone(go[1]), dead_zone(go[2])) * base.step[a]
    view = seen_from(decoders, place, chosen[d])
    outputs = bias_of(decoders, k)
    for j in range(HIDDEN_UNITS):
        h = wp.max(hidden_unit(base, decoders, a, j, z, view), 0.0)
        outputs = with_unit(outputs, decoders, j, k, h)
    offset = base.offset[a, k]
    for n in range(12):
        offset += decoders.offset[n, k] * far[n]
    i = a * base.offset.shape[1] + k
    write(cloud, d, i, place + wp.cw_mul(offset, base.offset_size[a]), base.scale_size[a], outputs)
    if d == 0 and k == 0:
        steps[a] = go
        latents = float(0.0)
        for n in range(LATENT_COUNT):
            latents += quantised(values[a * NUMBERS + n])
        gone = quantised(go[0]) + quantised(go[1]) + quantised(go[2])
        rows[a] = wp.vec2(latents, gone)
        wp.atomic_add(totals, SUM_LATENTS, latents)
        wp.atomic_add(totals, SUM_POSITIONS, gone)


@wp.kernel(enable_backward=False, grid_stride=False)
def differentiate_decode(
    values: wp.array[float],
    base: AnchorBase,
    decoders: Decoders,
    chosen: wp.array[int],
    cloud: Cloud,
    by: Cloud,
    pulls: wp.array3d[float],
) -> None:
    """Grid (N, K); gradients go straight through the rounding.

    Args:
        values, base, decoders, chosen, cloud: as for `decode`. by: [D,N*K] the loss's gradient by `cloud`.
        pulls: out, [K,N,27] what each Gaussian asks of its anchor's latents and steps.
    """
    a, k = wp.tid()
    if a >= base.count[0]:
        return
    z = integers(values, a * NUMBERS)
    go = going(values, base, a)
    place = base.node[a] + wp.vec3(dead_zone(go[0]), dead_zone(go[1]), dead_zone(go[2])) * base.step[a]
    i = a * base.offset.shape[1] + k
    to_feature = vec12()
    to_mean = wp.vec3(0.0, 0.0, 0.0)
    for d in range(cloud.means.shape[0]):
        view = seen_from(decoders, place, chosen[d])
        slopes = by_outputs(cloud, by, d, i, base.scale_size[a])
        to_mean += by.means[d, i]
        for j in range(HIDDEN_UNITS):
            if hidden_unit(base, decoders, a, j, z, view) > 0.0:
                to_feature += decoders.latent[j] * by_unit(slopes, decoders, j, k)
    moved = wp.cw_mul(to_mean, base.offset_size[a])
    for n in range(12):
        pulls[k, a, n] = to_feature[n]
    for n in range(12):
        pulls[k, a, 12 + n] = wp.dot(decoders.offset[n, k], moved)
    pulls[k, a, 24] = to_mean[0] * base.step[a]
    pulls[k, a, 25] = to_mean[1] * base.step[a]
    pulls[k, a, 26] = to_mean[2] * base.step[a]
