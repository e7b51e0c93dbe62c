"""Rounding of residuals: one rule for training and for coding.

The quantised state is an integer, and so is what is added to it, so that encoder and decoder never differ.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from streamlod.core.arrays import Int64

DEFAULT_OFFSET = 0.34  # measured: docs/bitstream.md; 0.5 would be plain rounding


def trailing_zeros(matrix: NDArray[Any], most: int) -> Int64:
    """[n] number of trailing zero bits common to each row of `matrix` [n,C]; at most `most`, as for a row of zeros."""
    joined = np.bitwise_or.reduce(matrix.astype(np.int64), axis=1)
    zeros = np.log2(np.maximum(joined & -joined, 1)).astype(np.int64)
    return np.where(joined == 0, most, np.minimum(zeros, most))
