"""A stream that is nothing but columns, as tests and benchmarks of the coder alone decode it."""

from __future__ import annotations

import numpy as np

from streamlod.codec.coder.column_model import take_columns
from streamlod.codec.coder.rans import Array, begin, finish


def decode_columns(words: Array, lanes: int, values: Array, scale: Array) -> bool:
    """Fill `values` [rows, C]; False if the stream is corrupt."""
    x, ctl = np.zeros(lanes, np.int64), np.zeros(3, np.int64)
    begin(words, x, ctl)
    take_columns(words, x, ctl, values, np.arange(len(values)), scale)
    return bool(finish(words, x, ctl))
