"""One step of Adam (Kingma and Ba 2015, algorithm 1) over a flat parameter."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from streamlod.core.arrays import Float32, Int64
from streamlod.core.render.cpu.kernels.inline.constants import KERNEL, SERIAL, ZERO

_LARGEST = np.finfo(np.float32).max


@numba.njit(**SERIAL)
def _update(value: Float32, gradient: Float32, first: Float32, second: Float32, numbers: Any) -> Any:
    """Update one worker's slices, each indexed from 0: LLVM does not vectorise where an index may be negative."""
    rate, inverse, news1, news2, epsilon = numbers
    lost = np.int64(0)
    for i in range(value.shape[0]):
        good = abs(gradient[i]) <= _LARGEST  # false for NaN too
        g = gradient[i] if good else ZERO
        lost += np.int64(0) if good else np.int64(1)
        first[i] += news1 * (g - first[i])
        second[i] += news2 * (g * g - second[i])
        value[i] -= rate * first[i] / (math.sqrt(second[i] * inverse) + epsilon)
    return lost


@numba.njit(**KERNEL)
def adam_step(
    workers: int, value: Float32, gradient: Float32, first: Float32, second: Float32, numbers: Any, broken: Int64
) -> None:
    """Update `value` and both moments, all [n], in place.

    Args:
        numbers: (rate / correction of the first moment, 1 / correction of the second, 1 - beta1, 1 - beta2, epsilon),
            float32; the complements, since 1 - beta2 loses four digits in float32.
        broken: out, [workers] entries of the gradient that were not finite and counted as zero.
    """
    count = value.shape[0]
    for w in numba.prange(workers):
        own = slice(count * w // workers, count * (w + 1) // workers)
        broken[w] = _update(value[own], gradient[own], first[own], second[own], numbers)
