"""Bits of a residual and their gradient: the kernel behind `core.train.rate`."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from core.arrays import Float32
from core.entropy_model import BINS, UNIT_BIN
from core.quantise import DEFAULT_OFFSET
from core.render.cpu.kernels.inline.constants import ONE, SERIAL, ZERO

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
def _coded_bits(values: Float32, table: Float32, typical: float, gradient: Float32) -> float:
    """Bits of `values` [n,C], coded row by row; their derivatives into `gradient` [n,C]."""
    rows, channels = values.shape
    limit = np.float32(table.shape[1] - 1) - np.float32(0.01)
    typical *= channels
    total = 0.0
    for i in range(rows):
        for c in range(channels):
            total += _rounded(values[i, c], limit)
    average = np.float32(typical * total / max(1, rows * channels))
    share = np.float32(1 / (typical + channels - 1))
    bits = 0.0
    for i in range(rows):
        whole = ZERO
        for c in range(channels):
            whole += _rounded(values[i, c], limit)
        usual = _bin((average + whole) * share)  # of the many values that round to zero
        for c in range(channels):
            value = values[i, c]
            size, own = _size(value, limit), _rounded(value, limit)
            k = usual if own == ZERO else _bin((average + whole - own) * share)
            lower = int(size)
            slope = table[k, lower + 1] - table[k, lower]
            bits += table[k, lower] + (size - np.float32(lower)) * slope
            gradient[i, c] = np.sign(value) * slope if size < limit else ZERO
    return float(bits)


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


@numba.njit(**{**SERIAL, "cache": True})
def residual_bits(
    latent: Float32,
    position: Float32,
    table: Float32,
    typical: float,
    set_bits: float,
    to_latent: Float32,
    to_position: Float32,
) -> float:
    """Bits as `core.train.rate` says, and their derivatives.

    Args:
        latent: [n,24]. position: [n,3]. table: [BINS,H+1] bits of each magnitude.
        typical: weight of the average anchor. set_bits: of an anchor that changes.
        to_latent, to_position: out, of the shapes of `latent` and `position`.
    """
    bits = _coded_bits(latent, table, typical, to_latent) + _coded_bits(position, table, typical, to_position)
    for i in range(latent.shape[0]):
        size = max(_largest(latent, i), _largest(position, i))
        bits += set_bits * min(size, ONE)
        if ZERO < size <= ONE:  # shared among the largest, as torch shares the gradient of a maximum
            slope = np.float32(set_bits / (_count(latent, i, size) + _count(position, i, size)))
            _add(latent, i, size, slope, to_latent)
            _add(position, i, size, slope, to_position)
    return float(bits)
