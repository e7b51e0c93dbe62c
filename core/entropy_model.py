"""The frozen probability tables, and what a value costs under them: one model for coding and training.

A value is coded under a *bin*, a quarter octave of expected magnitude: bin b expects 2^((b - 24) / 4). The rows of
`FREQUENCIES`, in 1/4096, are fitted to trained scenes (docs/bitstream.md): a two-sided geometric law with a dead zone,
P(0) = 1 - q^0.62 and P(|v| = k) = q^0.62 (1 - q) q^(k-1), corrected by what keyframes and changes of two clips showed,
so that none of these is far from the tables it would have of its own; `tests.bench.codec_tables` fits them. The
numbers are the definition (FORMAT.md, section 12).
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
    (4044, 19, 19, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (4012, 33, 33, 3, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3980, 51, 51, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3934, 71, 71, 4, 4, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3900, 87, 87, 5, 5, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3824, 120, 120, 10, 10, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3822, 127, 127, 4, 4, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3820, 126, 126, 6, 6, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3802, 136, 136, 5, 5, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3780, 145, 145, 7, 7, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3738, 162, 162, 10, 10, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3690, 181, 181, 15, 15, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3640, 204, 204, 16, 16, 3, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3602, 219, 219, 18, 18, 5, 5, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3570, 234, 234, 20, 20, 4, 4, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3447, 287, 287, 27, 27, 5, 5, 1, 1, 1, 1, 1, 1, 1, 1, 1, 2),
    (3324, 338, 338, 35, 35, 7, 7, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1),
    (3150, 407, 407, 49, 49, 10, 10, 3, 3, 1, 1, 1, 1, 1, 1, 1, 1),
    (2920, 512, 512, 57, 57, 11, 11, 3, 3, 2, 2, 1, 1, 1, 1, 1, 1),
    (2707, 601, 601, 66, 66, 15, 15, 7, 7, 2, 2, 1, 1, 1, 1, 1, 2),
    (2506, 673, 673, 84, 84, 24, 24, 8, 8, 3, 3, 1, 1, 1, 1, 1, 1),
    (2317, 722, 722, 123, 123, 25, 25, 12, 12, 4, 4, 1, 1, 1, 1, 1, 2),
    (2099, 756, 756, 166, 166, 45, 45, 17, 17, 7, 7, 2, 2, 2, 2, 1, 6),
    (1951, 765, 765, 199, 199, 60, 60, 22, 22, 10, 10, 5, 5, 2, 2, 7, 12),
    (1732, 753, 753, 267, 267, 95, 95, 34, 34, 13, 13, 7, 7, 3, 3, 2, 18),
    (1533, 710, 710, 318, 318, 137, 137, 61, 61, 21, 21, 11, 11, 8, 8, 10, 21),
    (1376, 673, 673, 340, 340, 173, 173, 78, 78, 40, 40, 19, 19, 9, 9, 10, 46),
    (1103, 659, 659, 381, 381, 215, 215, 117, 117, 59, 59, 28, 28, 14, 14, 9, 38),
    (930, 603, 603, 387, 387, 247, 247, 154, 154, 82, 82, 44, 44, 26, 26, 11, 69),
    (795, 553, 553, 375, 375, 259, 259, 178, 178, 109, 109, 66, 66, 42, 42, 21, 116),
    (675, 501, 501, 351, 351, 264, 264, 197, 197, 133, 133, 92, 92, 59, 59, 33, 194),
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
