"""The frozen probability tables, and what a value costs under them: one model for coding and training.

A value is coded under a *bin*, a quarter octave of expected magnitude: bin b expects 2^((b - 24) / 4). Row b of
`FREQUENCIES` is a two-sided geometric law with a dead zone, P(0) = 1 - q^0.62 and P(|v| = k) = q^0.62 (1 - q) q^(k-1),
of that mean, in 1/4096. The numbers below, not this formula, are the definition (FORMAT.md section 12).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import Float32, Int64

BINS = 31
UNIT_BIN = 24  # bin of expected magnitude 1
SYMBOLS = 17  # 16 zigzag values, then the escape
ESCAPE = 16
PROBABILITY_BITS = 12
MAGNITUDE_UNIT = 256  # expected magnitudes are integers in 1/256

# fmt: off
FREQUENCIES: Int64 = np.array((
    (4020, 31, 31, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (4008, 37, 37, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3992, 45, 45, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3976, 53, 53, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3956, 63, 63, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3932, 75, 75, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3904, 89, 89, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3872, 105, 105, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3832, 125, 125, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3786, 147, 147, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3730, 174, 174, 3, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3666, 204, 204, 5, 5, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3592, 239, 239, 7, 7, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3504, 278, 278, 12, 12, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3406, 322, 322, 17, 17, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3290, 371, 371, 26, 26, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3160, 422, 422, 38, 38, 3, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3014, 475, 475, 55, 55, 6, 6, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (2854, 529, 529, 76, 76, 11, 11, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (2680, 579, 579, 104, 104, 18, 18, 3, 3, 1, 1, 1, 1, 1, 1, 1, 1),
    (2496, 624, 624, 136, 136, 30, 30, 6, 6, 1, 1, 1, 1, 1, 1, 1, 1),
    (2304, 659, 659, 174, 174, 45, 45, 12, 12, 3, 3, 1, 1, 1, 1, 1, 1),
    (2110, 684, 684, 213, 213, 66, 66, 20, 20, 6, 6, 2, 2, 1, 1, 1, 1),
    (1912, 696, 696, 253, 253, 92, 92, 33, 33, 12, 12, 4, 4, 1, 1, 1, 1),
    (1718, 694, 694, 290, 290, 121, 121, 50, 50, 21, 21, 8, 8, 3, 3, 1, 3),
    (1534, 678, 678, 320, 320, 151, 151, 71, 71, 33, 33, 15, 15, 7, 7, 3, 9),
    (1354, 652, 652, 342, 342, 180, 180, 94, 94, 49, 49, 26, 26, 13, 13, 7, 23),
    (1191, 615, 615, 355, 355, 205, 205, 118, 118, 68, 68, 39, 39, 22, 22, 13, 48),
    (1042, 572, 572, 358, 358, 224, 224, 140, 140, 87, 87, 55, 55, 34, 34, 21, 93),
    (906, 525, 525, 352, 352, 236, 236, 159, 159, 106, 106, 71, 71, 48, 48, 32, 164),
    (783, 476, 476, 339, 339, 242, 242, 172, 172, 123, 123, 87, 87, 62, 62, 44, 267),
), np.int64)

BIN_THRESHOLDS: Int64 = np.array((
    4, 5, 6, 7, 9, 10, 12, 15, 17, 21, 25, 29, 35, 41, 49, 59, 70, 83, 99, 117,
    140, 166, 197, 235, 279, 332, 395, 470, 558, 664,
), np.int64)
# fmt: on
BIN_LIMIT = 790  # from here on a magnitude is halved, and four bins are added
HIGHEST_SCALE = 191
SCALES: Int64 = np.array([round(2 ** (q / 8)) for q in range(HIGHEST_SCALE + 1)], np.int64)  # in 1/256; as in FORMAT.md


def bin_of(magnitude: float) -> int:
    """Bin of an expected magnitude |v|, clamped to the rows of `FREQUENCIES`."""
    units = int(magnitude * MAGNITUDE_UNIT)
    return int(np.searchsorted(BIN_THRESHOLDS, units, side="right"))


def magnitude_bits(highest: int = 64) -> Float32:
    """[BINS, highest + 1] bits that |v| = 0 .. `highest` costs in each bin, sign included.

    Between integers the cost is meant to be interpolated linearly: with k = floor(|v|) and f = |v| - k,
    ``(1 - f) * table[bin, k] + f * table[bin, k + 1]`` is the rate term of training (codec notes, section 5).
    """
    bits = PROBABILITY_BITS - np.log2(FREQUENCIES)
    table = np.empty((BINS, highest + 1))
    for magnitude in range(highest + 1):
        signs = (2 * magnitude,) if magnitude == 0 else (2 * magnitude - 1, 2 * magnitude)
        table[:, magnitude] = np.mean([_symbol_bits(bits, symbol) for symbol in signs], axis=0)
    return table.astype(np.float32)


def _symbol_bits(bits: NDArray[Any], symbol: int) -> NDArray[Any]:
    """Cost of one zigzag symbol in all bins; beyond the table an escape and an exponential Golomb code follow."""
    if symbol < ESCAPE:
        return np.asarray(bits[:, symbol])
    return np.asarray(bits[:, ESCAPE] + 2 * ((symbol - ESCAPE + 1).bit_length() - 1) + 1)
