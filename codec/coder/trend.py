"""A running mean of the rows before as prediction of a channel, in the row's own precision. FORMAT.md section 8."""

from __future__ import annotations

import numpy as np

from streamlod.codec.coder.compiled import compiled
from streamlod.codec.coder.rans import Array

_SHIFT = 3  # the mean of about 2^3 rows; its sum is kept, so that nothing is lost


@compiled
def _prediction(total: int, shift: int) -> int:
    """The running mean, rounded to a multiple of 2^`shift`."""
    return (((total >> _SHIFT) + ((1 << shift) >> 1)) >> shift) << shift


@compiled
def trend_errors(values: Array, shifts: Array) -> Array:
    """[n] prediction errors of `values` [n], in units of 2^`shifts` [n]; each value is a multiple of its unit."""
    errors, total = np.zeros(len(values), np.int64), 0
    for i in range(len(values)):
        errors[i] = (values[i] - _prediction(total, shifts[i])) >> shifts[i]
        total += values[i] - (total >> _SHIFT)
    return errors


@compiled
def add_trend(errors: Array, shifts: Array) -> Array:
    """Inverse of `trend_errors`."""
    values, total = np.zeros(len(errors), np.int64), 0
    for i in range(len(errors)):
        values[i] = (errors[i] << shifts[i]) + _prediction(total, shifts[i])
        total += values[i] - (total >> _SHIFT)
    return values
