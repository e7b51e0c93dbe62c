"""One step of Adam (Kingma and Ba 2015, algorithm 1) over all that is trained, and the mean of the last steps."""

from __future__ import annotations

import warp as wp

from streamlod.core.train.engine.warp.kernels.layout import (
    INVERSE_SECOND,
    LATENT_COUNT,
    MEAN_WEIGHT,
    NEWS_FIRST,
    NEWS_SECOND,
    NUMBERS,
    PLACE,
    PRICE,
    RATE_LATENT,
    RATE_POSITION,
    SUM_BITS,
    SUM_LATENTS,
    SUM_LOSS,
    SUM_POSITIONS,
)

LARGEST = wp.constant(3.4028234e38)
EPSILON = wp.constant(1e-15)


@wp.func
def sound(gradient: float, broken: wp.array[int]) -> float:
    """A gradient, or zero where it is not finite, which is counted."""
    found = gradient
    if not (wp.abs(gradient) <= LARGEST):  # true for NaN too
        found = 0.0
        wp.atomic_add(broken, 0, 1)
    return found


@wp.func
def stepped(
    gradient: float, first: float, second: float, value: float, rate: float, inverse: float, told: wp.array[float]
) -> wp.vec3:
    """Both moments and the value after a step at `rate`; `inverse`: one over the second moment's correction."""
    m = first + told[NEWS_FIRST] * (gradient - first)
    v = second + told[NEWS_SECOND] * (gradient * gradient - second)
    return wp.vec3(m, v, value - rate * m / (wp.sqrt(v * inverse) + EPSILON))


@wp.kernel(enable_backward=False, grid_stride=False)
def adam(
    told: wp.array[float],
    gradient: wp.array[float],
    first: wp.array[float],
    second: wp.array[float],
    values: wp.array[float],
    mean: wp.array[float],
    broken: wp.array[int],
    totals: wp.array[float],
    losses: wp.array[float],
) -> None:
    """Grid: every number that is trained, 27 an anchor.

    Args:
        told: see `layout`. gradient: in, back to zero. first, second: moments. values: the numbers.
        mean: of the steps with a weight. broken: [1] entries so far that were not finite and counted as zero.
        totals: in, back to zero, with the step's loss in `losses` at the place that `told` says.
    """
    p = wp.tid()
    rate = wp.where(p % NUMBERS < LATENT_COUNT, told[RATE_LATENT], told[RATE_POSITION])
    g = sound(gradient[p], broken)
    gradient[p] = 0.0
    now = stepped(g, first[p], second[p], values[p], rate, told[INVERSE_SECOND], told)
    first[p] = now[0]
    second[p] = now[1]
    values[p] = now[2]
    mean[p] = mean[p] + told[MEAN_WEIGHT] * (now[2] - mean[p])
    if p == 0:
        losses[int(told[PLACE])] = totals[SUM_LOSS] + told[PRICE] * totals[SUM_BITS]
        totals[SUM_LATENTS] = 0.0
        totals[SUM_POSITIONS] = 0.0
        totals[SUM_LOSS] = 0.0
        totals[SUM_BITS] = 0.0
