"""The frozen probability tables, and what a value costs under them: one model for coding and training.

A value is coded under a *bin*, a quarter octave of expected magnitude: bin b expects 2^((b - 24) / 4). The rows of
`FREQUENCIES`, in 1/4096, are fitted to trained scenes (docs/bitstream.md): a two-sided geometric law with a dead zone,
P(0) = 1 - q^0.62 and P(|v| = k) = q^0.62 (1 - q) q^(k-1), corrected by what keyframes and changes of two clips showed,
so that none of these is far from the tables it would have of its own. The numbers are the definition (FORMAT.md,
section 12).
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
    (4012, 35, 35, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3950, 66, 66, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3920, 81, 81, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3868, 107, 107, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3864, 109, 109, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3804, 139, 139, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3776, 153, 153, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3724, 177, 177, 3, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3684, 199, 199, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3680, 201, 201, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3676, 202, 202, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3660, 209, 209, 3, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3596, 239, 239, 5, 5, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3544, 265, 265, 5, 5, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3428, 322, 322, 6, 6, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3320, 373, 373, 9, 9, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3192, 432, 432, 12, 12, 3, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3046, 493, 493, 22, 22, 4, 4, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1),
    (2898, 556, 556, 31, 31, 6, 6, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1),
    (2706, 625, 625, 50, 50, 13, 13, 3, 3, 1, 1, 1, 1, 1, 1, 1, 1),
    (2502, 692, 692, 72, 72, 19, 19, 8, 8, 3, 3, 1, 1, 1, 1, 1, 1),
    (2279, 749, 749, 106, 106, 33, 33, 10, 10, 5, 5, 3, 3, 1, 1, 1, 2),
    (2086, 760, 760, 159, 159, 50, 50, 18, 18, 10, 10, 4, 4, 2, 2, 1, 3),
    (1893, 742, 742, 214, 214, 83, 83, 34, 34, 18, 18, 6, 6, 2, 2, 1, 4),
    (1755, 687, 687, 268, 268, 114, 114, 51, 51, 31, 31, 10, 10, 3, 3, 1, 12),
    (1559, 616, 616, 336, 336, 163, 163, 84, 84, 40, 40, 11, 11, 5, 5, 3, 24),
    (1414, 619, 619, 324, 324, 171, 171, 107, 107, 63, 63, 31, 31, 8, 8, 11, 25),
    (1078, 621, 621, 408, 408, 227, 227, 119, 119, 61, 61, 35, 35, 16, 16, 10, 34),
    (935, 565, 565, 390, 390, 247, 247, 166, 166, 96, 96, 50, 50, 30, 30, 22, 51),
    (838, 509, 509, 371, 371, 264, 264, 185, 185, 117, 117, 73, 73, 40, 40, 34, 106),
    (694, 435, 435, 362, 362, 267, 267, 211, 211, 148, 148, 115, 115, 65, 65, 53, 143),
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
