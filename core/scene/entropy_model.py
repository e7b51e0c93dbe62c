"""The fixed probability tables, and the cost of a value under them, shared by codec and training.

A value is coded under a *bin*, a quarter octave of expected magnitude: bin b expects 2^((b - 24) / 4). The rows of
`FREQUENCIES`, in 1/4096, are fitted to trained scenes (docs/bitstream.md): a two-sided geometric law with a dead zone,
P(0) = 1 - q^0.62 and P(|v| = k) = q^0.62 (1 - q) q^(k-1), adjusted to keyframes and changes of two clips, such that
each of these costs little more than under tables of its own; `tests.bench.codec_tables` fits them. The numbers are
part of the format (FORMAT.md, section 12).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from streamlod.core.arrays import Float32, Int64

BINS = 31
UNIT_BIN = 24  # bin of expected magnitude 1
SYMBOLS = 17  # 16 zigzag values, then the escape
ESCAPE = 16
PROBABILITY_BITS = 12
MAGNITUDE_UNIT = 256  # expected magnitudes are integers in 1/256

# fmt: off
FREQUENCIES: Int64 = np.array((
    (4042, 20, 20, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (4002, 40, 40, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3940, 68, 68, 4, 4, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3916, 79, 79, 5, 5, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3828, 118, 118, 10, 10, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3826, 126, 126, 3, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3824, 123, 123, 7, 7, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3822, 125, 125, 6, 6, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3806, 132, 132, 7, 7, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3764, 151, 151, 8, 8, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3710, 173, 173, 14, 14, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3682, 187, 187, 13, 13, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3634, 205, 205, 17, 17, 4, 4, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3592, 223, 223, 20, 20, 4, 4, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3516, 256, 256, 24, 24, 5, 5, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1),
    (3398, 303, 303, 33, 33, 7, 7, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1),
    (3270, 356, 356, 41, 41, 9, 9, 3, 3, 1, 1, 1, 1, 1, 1, 1, 1),
    (3064, 440, 440, 56, 56, 12, 12, 4, 4, 1, 1, 1, 1, 1, 1, 1, 1),
    (2826, 551, 551, 60, 60, 14, 14, 5, 5, 2, 2, 1, 1, 1, 1, 1, 1),
    (2619, 636, 636, 70, 70, 20, 20, 7, 7, 2, 2, 1, 1, 1, 1, 1, 2),
    (2410, 715, 715, 93, 93, 20, 20, 9, 9, 3, 3, 1, 1, 1, 1, 1, 1),
    (2222, 748, 748, 130, 130, 34, 34, 14, 14, 6, 6, 2, 2, 1, 1, 1, 3),
    (2034, 785, 785, 168, 168, 45, 45, 15, 15, 8, 8, 3, 3, 2, 2, 4, 6),
    (1922, 768, 768, 204, 204, 63, 63, 26, 26, 9, 9, 6, 6, 3, 3, 3, 13),
    (1691, 761, 761, 272, 272, 98, 98, 35, 35, 15, 15, 7, 7, 2, 2, 2, 23),
    (1527, 715, 715, 314, 314, 132, 132, 61, 61, 24, 24, 12, 12, 9, 9, 11, 24),
    (1384, 669, 669, 341, 341, 172, 172, 79, 79, 39, 39, 18, 18, 11, 11, 12, 42),
    (1113, 659, 659, 378, 378, 213, 213, 116, 116, 59, 59, 29, 29, 13, 13, 9, 40),
    (932, 608, 608, 381, 381, 245, 245, 154, 154, 82, 82, 44, 44, 28, 28, 10, 70),
    (793, 554, 554, 376, 376, 258, 258, 177, 177, 110, 110, 66, 66, 41, 41, 22, 117),
    (681, 505, 505, 349, 349, 260, 260, 197, 197, 131, 131, 91, 91, 59, 59, 33, 198),
), np.int64)

BIN_THRESHOLDS: Int64 = np.array((
    4, 5, 6, 7, 9, 10, 12, 15, 17, 21, 25, 29, 35, 41, 49, 59, 70, 83, 99, 117,
    140, 166, 197, 235, 279, 332, 395, 470, 558, 664,
), np.int64)
# fmt: on
HALVED_FROM = 790  # from here on a magnitude is halved, and four bins are added
MAX_SCALE = 191
SCALES: Int64 = np.array([round(2 ** (q / 8)) for q in range(MAX_SCALE + 1)], np.int64)  # in 1/256; as in FORMAT.md


def magnitude_bits(highest: int) -> Float32:
    """[BINS, highest + 1] bits that |v| = 0 .. `highest` costs in each bin, sign included.

    Between integers the cost is interpolated linearly: with k = floor(|v|) and f = |v| - k,
    ``(1 - f) * table[bin, k] + f * table[bin, k + 1]`` is the rate term of training.
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
