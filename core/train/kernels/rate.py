"""Bits of coded values and their gradient: the kernel behind `core.train.rate`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from core.arrays import Float32
from core.entropy_model import BINS, UNIT_BIN
from core.quantise import DEFAULT_OFFSET
from core.render.cpu.kernels.inline.constants import SERIAL

_OFFSET = np.float32(DEFAULT_OFFSET)


@njit(**SERIAL)
def _size(value: Any, limit: Any) -> Any:
    size = abs(value)
    return size if size < limit else limit  # NaN too


@njit(**SERIAL)
def _bin(expected: Any) -> int:
    nearest = int(np.rint(np.float32(UNIT_BIN) + np.float32(4) * np.log2(max(expected, np.float32(1e-3)))))
    return min(max(nearest, 0), BINS - 1)


@njit(**{**SERIAL, "cache": True})
def coded_bits(values: Float32, table: Float32, typical: float, gradient: Float32) -> float:
    """Bits of `values` [n,C], coded row by row as `core.train.rate` says; their derivatives are added to `gradient`.

    Args:
        table: [BINS,H+1] bits of each magnitude. typical: weight of the average value, in values.
        gradient: [n,C] added to.
    """
    rows, channels = values.shape
    limit = np.float32(table.shape[1] - 1) - np.float32(0.01)
    total = 0.0
    for i in range(rows):
        for c in range(channels):
            total += math.floor(_size(values[i, c], limit) + _OFFSET)
    average = np.float32(typical * total / max(1, rows * channels))
    share = np.float32(1 / (typical + channels - 1))
    bits = 0.0
    for i in range(rows):
        whole = np.float32(0)
        for c in range(channels):
            whole += np.float32(math.floor(_size(values[i, c], limit) + _OFFSET))
        usual = _bin((average + whole) * share)  # of the many values that round to zero
        for c in range(channels):
            value = values[i, c]
            size = _size(value, limit)
            own = np.float32(math.floor(size + _OFFSET))
            k = usual if own == 0 else _bin((average + whole - own) * share)
            lower = int(size)
            slope = table[k, lower + 1] - table[k, lower]
            bits += table[k, lower] + (size - np.float32(lower)) * slope
            if size < limit:
                gradient[i, c] += np.sign(value) * slope
    return bits
