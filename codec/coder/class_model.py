"""Rows in classes of precision, each class coded as columns of its own, as compiled loops. FORMAT.md section 6.4."""

from __future__ import annotations

import numpy as np

from streamlod.codec.coder.column_model import columns_items, take_columns
from streamlod.codec.coder.compiled import compiled
from streamlod.codec.coder.rans import Array, begin, finish, put_flag, take_flag

MAX_CLASSES = 8


@compiled
def classes_items(classes: Array, count: int, items: Array, n: int) -> int:
    """Model pass over the class [rows] of each row, below `count`, in unary."""
    models = np.ones((MAX_CLASSES, 2), np.int64)
    for own in classes:
        for k in range(count - 1):
            n = put_flag(items, n, models[k], 1 if own == k else 0)
            if own == k:
                break
    return n


@compiled
def _take_classes(words: Array, x: Array, ctl: Array, classes: Array, count: int) -> None:
    """Decode the class [rows] of each row."""
    models = np.ones((MAX_CLASSES, 2), np.int64)
    for i in range(len(classes)):
        own = count - 1
        for k in range(count - 1):
            if take_flag(words, x, ctl, models[k]):
                own = k
                break
        classes[i] = own
        if ctl[2]:
            return


@compiled
def rows_items(values: Array, classes: Array, scales: Array, items: Array, n: int) -> int:
    """Model pass over `values` [rows, C]: their classes, then each class with its row of `scales` [classes, C]."""
    n = classes_items(classes, len(scales), items, n)
    for k in range(len(scales)):
        n = columns_items(values[classes == k], scales[k], items, n)
    return n


@compiled
def decode_rows(words: Array, lanes: int, values: Array, classes: Array, scales: Array) -> bool:
    """Fill `values` [rows, C] and `classes` [rows]; False if the stream is corrupt."""
    x, ctl = np.zeros(lanes, np.int64), np.zeros(3, np.int64)
    begin(words, x, ctl)
    if ctl[2] == 0:
        _take_classes(words, x, ctl, classes, len(scales))
    for k in range(len(scales)):
        if ctl[2]:
            return False
        take_columns(words, x, ctl, values, np.flatnonzero(classes == k), scales[k])
    return finish(words, x, ctl)
