"""Interleaved rANS and the items it codes, as compiled loops. FORMAT.md section 6.2.

Encoding has two passes: a model pass lists *items* (start << 16 | frequency, in order of decoding), then `rans_encode`
codes the list backwards. Model passes return the number of items, or one beyond the list's length if it was too short.
Decoding keeps the lanes' states in `x` and three integers in `ctl`: items read, index of the next word, and 1 once the
stream was found corrupt. From then on values are meaningless, but no index leaves its array. `tests/codec/oracle.py`
is the slow reference.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from streamlod.codec.coder.compiled import compiled
from streamlod.core.arrays import Int64
from streamlod.core.scene.entropy_model import BIN_THRESHOLDS, BINS, ESCAPE, FREQUENCIES, HALVED_FROM, SYMBOLS

Array = NDArray[Any]

MIN_STATE = 1 << 16
MAX_VALUE = (1 << 30) - 1  # magnitude of a coded value
TOP_BIN = BINS - 1
_MAX_BIN = 120  # a shift of 23 bits: whatever the context, shifts stay below the width of a value
_MAX_WIDTH = 30  # bits of an escape

STARTS: Int64 = np.concatenate([np.zeros((BINS, 1), np.int64), np.cumsum(FREQUENCIES, axis=1)[:, :-1]], axis=1)
SYMBOL_OF = np.concatenate([np.repeat(np.arange(SYMBOLS), row) for row in FREQUENCIES]).astype(np.uint8)


@compiled
def magnitude_bin(e: int) -> int:
    """bin(e) of FORMAT.md section 6.2."""
    k = 0
    while e >= HALVED_FROM:
        e >>= 1
        k += 4
    low, high = 0, 30
    while low < high:
        middle = (low + high) >> 1
        if e >= BIN_THRESHOLDS[middle]:
            low = middle + 1
        else:
            high = middle
    return k + low


# Items, for encoding.


@compiled
def put_item(items: Array, n: int, start: int, freq: int) -> int:
    """Append the symbol with cumulative frequency `start` and frequency `freq`, in 1/4096; returns the new length."""
    if n < len(items):
        items[n] = start << 16 | freq
        return n + 1
    return len(items) + 1  # too short a list: all later calls return this as well


@compiled
def put_raw(items: Array, n: int, value: int, width: int) -> int:
    """Append the low `width` bits of `value`, equally likely; returns the new length."""
    while width > 0:
        group = min(width, 12)
        freq = 1 << (12 - group)
        n = put_item(items, n, (value & ((1 << group) - 1)) * freq, freq)
        value >>= group
        width -= group
    return n


@compiled
def put_flag(items: Array, n: int, model: Array, bit: int) -> int:
    """Append a bit under the adaptive counts `model` [2], which learn it; returns the new length."""
    split = min(max(4096 * model[0] // (model[0] + model[1]), 1), 4095)
    n = put_item(items, n, split, 4096 - split) if bit else put_item(items, n, 0, split)
    _adapt(model, bit)
    return n


@compiled
def _adapt(model: Array, bit: int) -> None:
    """Count `bit`; halve the counts before they grow too large, so that old bits are forgotten."""
    model[bit] += 2
    if model[0] + model[1] > 1020:
        model[0] = (model[0] + 1) >> 1
        model[1] = (model[1] + 1) >> 1


@compiled
def put_value(items: Array, n: int, value: int, b: int) -> int:
    """Append a signed integer under bin `b`; returns the new length."""
    b = min(max(b, 0), _MAX_BIN)
    shift = 0
    if b > TOP_BIN:
        shift = (b - TOP_BIN + 3) >> 2
        b -= 4 * shift
    half = (1 << shift) >> 1
    high = (value + half) >> shift
    z = 2 * high if high >= 0 else -2 * high - 1
    if z < ESCAPE:
        n = put_item(items, n, STARTS[b, z], FREQUENCIES[b, z])
    else:
        n = put_item(items, n, STARTS[b, ESCAPE], FREQUENCIES[b, ESCAPE])
        rest = z - ESCAPE + 1
        width = 0
        while rest >> (width + 1):
            width += 1
            n = put_raw(items, n, 1, 1)
        n = put_raw(items, n, 0, 1)
        n = put_raw(items, n, rest - (1 << width), width)
    return put_raw(items, n, value + half - (high << shift), shift)


@compiled
def rans_encode(items: Array, n: int, lanes: int, words: Array) -> int:
    """Code `items[:n]` into the end of `words`; returns the index of the first word. n + 2 `lanes` words are enough."""
    x = np.full(lanes, MIN_STATE, np.int64)
    p = len(words)
    for i in range(n - 1, -1, -1):
        k = i & (lanes - 1)
        start, freq = np.int64(items[i] >> 16), np.int64(items[i] & 0xFFFF)
        state = x[k]
        if state >= freq << 20:
            p -= 1
            words[p] = state & 0xFFFF
            state >>= 16
        x[k] = ((state // freq) << 12) + state % freq + start
    for k in range(lanes - 1, -1, -1):
        p -= 2
        words[p] = x[k] & 0xFFFF
        words[p + 1] = x[k] >> 16
    return p


# Decoding.


@compiled
def begin(words: Array, x: Array, ctl: Array) -> None:
    """Read the lanes' first states from the beginning of `words`."""
    if len(words) < 2 * len(x):
        ctl[2] = 1
        return
    for k in range(len(x)):
        x[k] = np.int64(words[2 * k]) | np.int64(words[2 * k + 1]) << 16
        if x[k] < MIN_STATE:
            ctl[2] = 1
    ctl[1] = 2 * len(x)


@compiled
def finish(words: Array, x: Array, ctl: Array) -> bool:
    """Whether the stream was sound: all words are read and every lane is back at its first state."""
    good = bool(ctl[2] == 0 and ctl[1] == len(words))
    for k in range(len(x)):
        good = good and bool(x[k] == MIN_STATE)
    return good


@compiled
def next_cumulative(x: Array, ctl: Array) -> int:
    """Where in the cumulative frequencies, 0 .. 4095, the next symbol lies."""
    return int(x[ctl[0] & (len(x) - 1)] & 4095)


@compiled
def take_item(words: Array, x: Array, ctl: Array, start: int, freq: int) -> None:
    """Remove the symbol with cumulative frequency `start` and frequency `freq` from its lane."""
    k = ctl[0] & (len(x) - 1)
    state = freq * (x[k] >> 12) + (x[k] & 4095) - start
    if state < MIN_STATE:
        if ctl[1] < len(words):
            state = state << 16 | np.int64(words[ctl[1]])
            ctl[1] += 1
        else:
            ctl[2] = 1
            state = MIN_STATE
    x[k] = state
    ctl[0] += 1


@compiled
def take_raw(words: Array, x: Array, ctl: Array, width: int) -> int:
    """Inverse of `put_raw`."""
    value, shift = 0, 0
    while width > 0:
        group = min(width, 12)
        bits = next_cumulative(x, ctl) >> (12 - group)
        take_item(words, x, ctl, bits << (12 - group), 1 << (12 - group))
        value |= bits << shift
        shift += group
        width -= group
    return value


@compiled
def take_flag(words: Array, x: Array, ctl: Array, model: Array) -> int:
    """Inverse of `put_flag`."""
    split = min(max(4096 * model[0] // (model[0] + model[1]), 1), 4095)
    bit = 1 if next_cumulative(x, ctl) >= split else 0
    if bit:
        take_item(words, x, ctl, split, 4096 - split)
    else:
        take_item(words, x, ctl, 0, split)
    _adapt(model, bit)
    return bit


@compiled
def take_value(words: Array, x: Array, ctl: Array, b: int) -> int:
    """Inverse of `put_value`."""
    b = min(max(b, 0), _MAX_BIN)
    shift = 0
    if b > TOP_BIN:
        shift = (b - TOP_BIN + 3) >> 2
        b -= 4 * shift
    z: Any = np.int64(SYMBOL_OF[b * 4096 + next_cumulative(x, ctl)])
    take_item(words, x, ctl, STARTS[b, z], FREQUENCIES[b, z])
    if z == ESCAPE:
        width = 0
        while take_raw(words, x, ctl, 1):
            width += 1
            if width > _MAX_WIDTH or ctl[2]:
                ctl[2] = 1
                return 0
        z = ESCAPE - 1 + (1 << width) + take_raw(words, x, ctl, width)
    high = -((z + 1) >> 1) if z & 1 else z >> 1
    value: Any = high
    if shift:
        value = (high << shift) - (1 << (shift - 1)) + take_raw(words, x, ctl, shift)
    if abs(value) > MAX_VALUE:
        ctl[2] = 1
        return 0
    return int(value)
