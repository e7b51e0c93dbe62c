"""Bits of a residual and their gradient: the kernel behind `core.train.optimise.rate`."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from streamlod.core.arrays import Float32, Float64, Int64
from streamlod.core.render.cpu.kernels.inline.constants import KERNEL, ONE, SERIAL, ZERO
from streamlod.core.scene.entropy_model import BINS, UNIT_BIN
from streamlod.core.scene.quantise import DEFAULT_OFFSET

_OFFSET = np.float32(DEFAULT_OFFSET)


@numba.njit(**SERIAL)
def _size(value: Any, limit: Any) -> Any:
    """Magnitude of a value, at most `limit`."""
    size = abs(value)
    return size if size < limit else limit  # NaN too


@numba.njit(**SERIAL)
def _rounded(value: Any, limit: Any) -> Any:
    """Magnitude of a value after quantisation (`core.scene.quantise`)."""
    return np.floor(_size(value, limit) + _OFFSET)


@numba.njit(**SERIAL)
def _total(values: Float32, first: int, end: int, limit: Any, rows: Float32) -> float:
    """Sum of the quantised magnitudes of rows [first, end); the sum of each row is written to `rows`."""
    total = 0.0
    for i in range(first, end):
        whole: Any = ZERO
        for c in range(values.shape[1]):
            whole += _rounded(values[i, c], limit)
        rows[i] = whole
        total += whole
    return total


@numba.njit(**SERIAL)
def _bins(rounded: Float32, total: float, channels: int, typical: float) -> Int64:
    """Bin under which a value is coded, by the sum of the other quantised magnitudes of its row.

    Args:
        rounded: [n] sum of the quantised magnitudes of each row; total: of all rows.
        channels: values of a row. typical: weight of the average row against the row itself.

    Returns:
        [S+1] bin where the others of the row sum to 0 .. S, the largest of `rounded`.
    """
    weight, rows = typical * channels, len(rounded)
    average = np.float32(weight * total / max(1, rows * channels))  # what the average row adds
    share = np.float32(1 / (weight + channels - 1))
    most: Any = ZERO
    for i in range(rows):
        most = max(most, rounded[i])
    bins = np.empty(int(most) + 1, np.int64)
    for rest in range(len(bins)):
        expected = max((average + np.float32(rest)) * share, np.float32(1e-3))
        nearest = int(np.rint(np.float32(UNIT_BIN) + np.float32(4) * np.log2(expected)))
        bins[rest] = min(max(nearest, 0), BINS - 1)
    return bins


@numba.njit(**SERIAL)
def _row_bits(values: Float32, i: int, whole: Any, table: Float32, limit: Any, bins: Int64, gradient: Float32) -> Any:
    """Bits of row `i`, whose quantised magnitudes sum to `whole`; derivatives are written to row `i` of `gradient`."""
    usual = bins[int(whole)]  # the bin of values that are quantised to zero, which most are
    start, slope = table[usual, 0], table[usual, 1] - table[usual, 0]
    sizes = ZERO
    for c in range(values.shape[1]):  # as though all were: no branches, so that LLVM vectorises the loop
        value = values[i, c]
        sizes += _size(value, limit)
        gradient[i, c] = slope if value > ZERO else (-slope if value < ZERO else ZERO)
    bits = np.float32(values.shape[1]) * start + sizes * slope
    if whole == ZERO:
        return bits
    for c in range(values.shape[1]):
        value = values[i, c]
        size, own = _size(value, limit), _rounded(value, limit)
        if own != ZERO:
            k, lower = bins[int(whole - own)], int(size)
            steeper = table[k, lower + 1] - table[k, lower]
            bits += table[k, lower] + (size - np.float32(lower)) * steeper - (start + size * slope)
            held = steeper if size < limit else ZERO
            gradient[i, c] = held if value > ZERO else (-held if value < ZERO else ZERO)
    return bits


@numba.njit(**SERIAL)
def _largest(values: Float32, i: int) -> Any:
    """Largest magnitude of row `i`."""
    largest = ZERO
    for c in range(values.shape[1]):
        size = abs(values[i, c])
        largest = size if size > largest else largest
    return largest


@numba.njit(**SERIAL)
def _count(values: Float32, i: int, size: Any) -> Any:
    """How many values of row `i` have magnitude `size`."""
    count = np.int32(0)
    for c in range(values.shape[1]):
        count += np.int32(1) if abs(values[i, c]) == size else np.int32(0)
    return count


@numba.njit(**SERIAL)
def _add(values: Float32, i: int, size: Any, slope: Any, gradient: Float32) -> None:
    """Add the derivative of `slope` times magnitude to `gradient` where a value of row `i` has magnitude `size`."""
    for c in range(values.shape[1]):
        value = values[i, c]
        gradient[i, c] += (slope if value == size else ZERO) - (slope if value == -size else ZERO)


@numba.njit(**SERIAL)
def _set_bits(latent: Float32, position: Float32, i: int, price: Any, to_latent: Float32, to_position: Float32) -> Any:
    """Bits that say that row `i` changes, at most `price`; derivatives are added to `to_latent` and `to_position`."""
    size = max(_largest(latent, i), _largest(position, i))
    if ZERO < size <= ONE:  # shared among the largest, as torch shares the gradient of a maximum
        slope = price / np.float32(_count(latent, i, size) + _count(position, i, size))
        _add(latent, i, size, slope, to_latent)
        _add(position, i, size, slope, to_position)
    return price * min(size, ONE)


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
    """Bits of the residuals of n anchors (`core.train.optimise.rate`), and their derivatives.

    Args:
        sums: [workers,3] work memory.
        latent: [n,24]. position: [n,3]. table: [BINS,H+1] bits of each magnitude 0 .. H.
        typical: weight of the average anchor. set_bits: float32, bits that say that an anchor changes.
        to_latent, to_position: out, of the shapes of `latent` and `position`.
    """
    workers, count = sums.shape[0], latent.shape[0]
    rows = np.empty((2, count), np.float32)
    limit = np.float32(table.shape[1] - 1) - np.float32(0.01)
    for w in numba.prange(workers):
        first, end = count * w // workers, count * (w + 1) // workers
        sums[w, 0] = _total(latent, first, end, limit, rows[0])
        sums[w, 1] = _total(position, first, end, limit, rows[1])
    of_latents = _bins(rows[0], sums[:, 0].sum(), latent.shape[1], typical)
    of_positions = _bins(rows[1], sums[:, 1].sum(), position.shape[1], typical)
    for w in numba.prange(workers):
        bits = 0.0
        for i in range(count * w // workers, count * (w + 1) // workers):
            bits += _row_bits(latent, i, rows[0, i], table, limit, of_latents, to_latent)
            bits += _row_bits(position, i, rows[1, i], table, limit, of_positions, to_position)
            bits += _set_bits(latent, position, i, set_bits, to_latent, to_position)
        sums[w, 2] = bits
    return float(sums[:, 2].sum())
