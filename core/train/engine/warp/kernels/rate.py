"""Bits of the residuals and their gradient (`core.train.optimise.rate`), and all that pulls at an anchor's numbers."""

from __future__ import annotations

import warp as wp

from streamlod.core.render.warp.kernels.lanes import is_first_lane, lanes_sum
from streamlod.core.scene.entropy_model import BINS, UNIT_BIN
from streamlod.core.train.engine.warp.kernels.layout import (
    DEAD_ZONE,
    LATENT_COUNT,
    NUMBERS,
    PRICE,
    SUM_BITS,
    SUM_LATENTS,
    SUM_POSITIONS,
    AnchorBase,
)
from streamlod.core.train.optimise.rate import SET_BITS

TYPICAL = wp.constant(0.5)  # weight of the average anchor beside the anchor's own other values
LIMIT = wp.constant(64.0 - 0.01)  # magnitudes count as at most this
LEAST = wp.constant(1e-3)  # expected magnitude
LAST_BIN, FIRST_OCTAVE = wp.constant(BINS - 1), wp.constant(float(UNIT_BIN))
CHANGED = wp.constant(SET_BITS)


@wp.func
def magnitude(value: float) -> float:
    """At most `LIMIT`, which is what a NaN counts as."""
    size = wp.abs(value)
    return wp.where(size < LIMIT, size, LIMIT)


@wp.func
def quantised(value: float) -> float:
    """The magnitude of the integer that a value is sent as."""
    return wp.floor(magnitude(value) + DEAD_ZONE)


@wp.func
def bin_of(rest: float, total: float, anchors: float, channels: float) -> int:
    """Bin under which a value is coded, of the sum of the others of its row and of all rows."""
    weight = TYPICAL * channels
    average = weight * total / wp.max(1.0, anchors * channels)
    expected = wp.max((average + rest) / (weight + channels - 1.0), LEAST)
    return wp.clamp(int(wp.rint(FIRST_OCTAVE + 4.0 * wp.log2(expected))), 0, LAST_BIN)


@wp.func
def number_of(values: wp.array[float], steps: wp.array[wp.vec3], a: int, n: int) -> float:
    """One of the 27 numbers that are sent of an anchor, before rounding."""
    gone = steps[a]  # chosen without an index: a vector that is indexed would lie in memory
    value = wp.where(n == LATENT_COUNT, gone[0], wp.where(n == LATENT_COUNT + 1, gone[1], gone[2]))
    if n < LATENT_COUNT:
        value = values[a * NUMBERS + n]
    return value


@wp.kernel(enable_backward=False, grid_stride=False)
def gather(
    values: wp.array[float],
    base: AnchorBase,
    steps: wp.array[wp.vec3],
    rows: wp.array[wp.vec2],
    table: wp.array2d[float],
    pulls: wp.array3d[float],
    told: wp.array[float],
    totals: wp.array[float],
    gradient: wp.array[float],
) -> None:
    """Grid (N, 32), a warp an anchor: add up what Gaussians and bits ask.

    Args:
        values, steps, rows, pulls: of `decode` and its derivative. table: [BINS,65] bits of each magnitude.
        told, totals: see `layout`; the bits are added to `totals`.
        gradient: out, [N*27].
    """
    a, n = wp.tid()
    bits = float(0.0)
    if a < base.count[0] and n < NUMBERS:
        value = number_of(values, steps, a, n)
        channels = float(LATENT_COUNT)
        whole = rows[a][0]
        total = totals[SUM_LATENTS]
        if n >= LATENT_COUNT:
            channels = 3.0
            whole = rows[a][1]
            total = totals[SUM_POSITIONS]
        size = magnitude(value)
        k = bin_of(whole - quantised(value), total, float(base.count[0]), channels)
        lower = int(size)
        slope = table[k, lower + 1] - table[k, lower]
        bits = table[k, lower] + (size - float(lower)) * slope
        if size >= LIMIT:
            slope = 0.0
        largest = float(0.0)
        for m in range(NUMBERS):
            largest = wp.max(largest, wp.abs(number_of(values, steps, a, m)))
        if wp.abs(value) == largest and largest <= 1.0:  # shared among the largest, as the gradient of a maximum
            same = float(0.0)
            for m in range(NUMBERS):
                if wp.abs(number_of(values, steps, a, m)) == largest:
                    same += 1.0
            slope += CHANGED / same
        if n == 0:
            bits += CHANGED * wp.min(largest, 1.0)
        pull = told[PRICE] * wp.where(value > 0.0, slope, wp.where(value < 0.0, -slope, 0.0))
        for s in range(pulls.shape[0]):
            pull += pulls[s, a, n]
        if n >= LATENT_COUNT:
            pull *= base.steps_a_pixel[a]
        gradient[a * NUMBERS + n] = pull
    bits = lanes_sum(bits)
    if is_first_lane():
        wp.atomic_add(totals, SUM_BITS, bits)
