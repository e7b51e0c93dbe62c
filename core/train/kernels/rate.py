"""Bits of a residual and their gradient: the kernel behind `core.train.rate`."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from core.arrays import Float32, Float64
from core.entropy_model import BINS, UNIT_BIN
from core.quantise import DEFAULT_OFFSET
from core.render.cpu.kernels.inline.constants import KERNEL, ONE, SERIAL, ZERO

_OFFSET = np.float32(DEFAULT_OFFSET)


@numba.njit(**SERIAL)
def _size(value: Any, limit: Any) -> Any:
    size = abs(value)
    return size if size < limit else limit  # NaN too


@numba.njit(**SERIAL)
def _rounded(value: Any, limit: Any) -> Any:
    return np.float32(math.floor(_size(value, limit) + _OFFSET))


@numba.njit(**SERIAL)
def _bin(expected: Any) -> int:
    nearest = int(np.rint(np.float32(UNIT_BIN) + np.float32(4) * np.log2(max(expected, np.float32(1e-3)))))
    return min(max(nearest, 0), BINS - 1)


@numba.njit(**SERIAL)
def _total(values: Float32, first: int, end: int, limit: Any) -> float:
    """Sum of what rows `first` to `end` round to."""
    total = 0.0
    for i in range(first, end):
        for c in range(values.shape[1]):
            total += _rounded(values[i, c], limit)
    return total


@numba.njit(**SERIAL)
def _row_bits(values: Float32, i: int, table: Float32, limit: Any, average: Any, share: Any, gradient: Float32) -> Any:
    """Bits of row `i`, and their derivatives into that of `gradient`."""
    whole = ZERO
    for c in range(values.shape[1]):
        whole += _rounded(values[i, c], limit)
    usual = _bin((average + whole) * share)  # of the many values that round to zero
    start, first_slope = table[usual, 0], table[usual, 1] - table[usual, 0]
    bits = ZERO
    for c in range(values.shape[1]):
        value = values[i, c]
        size, own = _size(value, limit), _rounded(value, limit)
        if own == ZERO:  # and so the size is below one
            bits += start + size * first_slope
            slope = first_slope
        else:
            k, lower = _bin((average + whole - own) * share), int(size)
            slope = table[k, lower + 1] - table[k, lower]
            bits += table[k, lower] + (size - np.float32(lower)) * slope
        held = slope if size < limit else ZERO
        gradient[i, c] = held if value > ZERO else (-held if value < ZERO else ZERO)
    return bits


@numba.njit(**SERIAL)
def _largest(values: Float32, i: int) -> Any:
    largest = ZERO
    for c in range(values.shape[1]):
        largest = max(largest, abs(values[i, c]))
    return largest


@numba.njit(**SERIAL)
def _count(values: Float32, i: int, size: Any) -> int:
    count = 0
    for c in range(values.shape[1]):
        if abs(values[i, c]) == size:
            count += 1
    return count


@numba.njit(**SERIAL)
def _add(values: Float32, i: int, size: Any, slope: Any, gradient: Float32) -> None:
    for c in range(values.shape[1]):
        if abs(values[i, c]) == size:
            gradient[i, c] += slope * np.sign(values[i, c])


@numba.njit(**SERIAL)
def _set_bits(latent: Float32, position: Float32, i: int, price: Any, to_latent: Float32, to_position: Float32) -> Any:
    """Bits for telling that row `i` changes; their derivatives are added."""
    size = max(_largest(latent, i), _largest(position, i))
    if ZERO < size <= ONE:  # shared among the largest, as torch shares the gradient of a maximum
        slope = price / np.float32(_count(latent, i, size) + _count(position, i, size))
        _add(latent, i, size, slope, to_latent)
        _add(position, i, size, slope, to_position)
    return price * min(size, ONE)


@numba.njit(**SERIAL)
def _factors(values: Float32, total: float, typical: float) -> Any:
    """What the average row adds to an expectation, and the factor of an expectation's sum."""
    rows, channels = values.shape
    weight = typical * channels
    return np.float32(weight * total / max(1, rows * channels)), np.float32(1 / (weight + channels - 1))


@numba.njit(**KERNEL)
def residual_bits(
    sums: Float64,
    latent: Float32,
    position: Float32,
    table: Float32,
    typical: float,
    set_bits: Any,
    to_latent: Float32,
    to_position: Float32,
) -> float:
    """Bits as `core.train.rate` says, and their derivatives.

    Args:
        sums: [workers,3] work memory.
        latent: [n,24]. position: [n,3]. table: [BINS,H+1] bits of each magnitude.
        typical: weight of the average anchor. set_bits: float32, of an anchor that changes.
        to_latent, to_position: out, of the shapes of `latent` and `position`.
    """
    workers, count = sums.shape[0], latent.shape[0]
    limit = np.float32(table.shape[1] - 1) - np.float32(0.01)
    for w in numba.prange(workers):
        first, end = count * w // workers, count * (w + 1) // workers
        sums[w, 0], sums[w, 1] = _total(latent, first, end, limit), _total(position, first, end, limit)
    of_latents = _factors(latent, sums[:, 0].sum(), typical)
    of_positions = _factors(position, sums[:, 1].sum(), typical)
    for w in numba.prange(workers):
        bits = 0.0
        for i in range(count * w // workers, count * (w + 1) // workers):
            bits += _row_bits(latent, i, table, limit, of_latents[0], of_latents[1], to_latent)
            bits += _row_bits(position, i, table, limit, of_positions[0], of_positions[1], to_position)
            bits += _set_bits(latent, position, i, set_bits, to_latent, to_position)
        sums[w, 2] = bits
    return float(sums[:, 2].sum())
