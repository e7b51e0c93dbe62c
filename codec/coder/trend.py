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
def restore(numbers: Array, shifts: Array, scaled: Array, modes: Array, centres: Array) -> bool:
    """Put in place of `numbers` [n,C] int32 the values that they stand for; False if one leaves int32.

    Args:
        shifts: [n] exponent of two of each row, for the channels where `scaled` [C] is 1.
        modes: [C] 2 where the prediction of `trend_errors` is to be added.
        centres: [C] to be added elsewhere.
    """
    totals = np.zeros(len(modes), np.int64)
    for i in range(len(numbers)):
        for c in range(len(modes)):
            shift = shifts[i] * scaled[c]
            value = (np.int64(numbers[i, c]) << shift) + centres[c]
            if modes[c] == 2:
                value += _prediction(totals[c], shift)
                totals[c] += value - (totals[c] >> _SHIFT)
            if value < -(1 << 31) or value >= 1 << 31:
                return False
            numbers[i, c] = value
    return True
