"""The entropy coder as compiled loops; `codec.oracle` is its slow twin. FORMAT.md sections 6, 7 and 9.

Encoding has two passes: a model pass lists *items* (start << 16 | frequency, in order of decoding), then `rans_encode`
codes the list backwards. Model passes return the number of items, or one beyond the list's length if it was too short.
Decoding keeps the lanes' states in `x` and, in `ctl`, the item counter, the next word, and whether anything was amiss.
All functions live in one module because Numba's cache looks at the calling file only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from codec.compiled import compiled
from core.arrays import Int64
from core.entropy_model import BIN_LIMIT, BIN_THRESHOLDS, BINS, ESCAPE, FREQUENCIES, SYMBOLS

Array = NDArray[Any]

LOWEST_STATE = 1 << 16
VALUE_LIMIT = 1 << 30  # no coded value has this magnitude
ENERGY_LIMIT = 65535
BLOCK = 64
BLOCK_MODELS, ROW_MODELS = 4, 8
OCTREE_MODELS = 16 * 256
_TOP_BIN = BINS - 1
_MOST_BIN = 120  # a shift of 23 bits, so that no sum of magnitudes asks for more than a value has
_MOST_WIDTH = 30  # bits of an escape

_STARTS: Int64 = np.concatenate([np.zeros((BINS, 1), np.int64), np.cumsum(FREQUENCIES, axis=1)[:, :-1]], axis=1)
_SYMBOL_OF = np.concatenate([np.repeat(np.arange(SYMBOLS), row) for row in FREQUENCIES]).astype(np.uint8)


@compiled
def magnitude_bin(e: int) -> int:
    """bin(e) of FORMAT.md section 6.2."""
    k = 0
    while e >= BIN_LIMIT:
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
def _put(items: Array, n: int, start: int, freq: int) -> int:
    if n < len(items):
        items[n] = start << 16 | freq
        return n + 1
    return len(items) + 1  # stays there: the list was too short


@compiled
def _put_raw(items: Array, n: int, value: int, width: int) -> int:
    while width > 0:
        group = min(width, 12)
        freq = 1 << (12 - group)
        n = _put(items, n, (value & ((1 << group) - 1)) * freq, freq)
        value >>= group
        width -= group
    return n


@compiled
def _put_flag(items: Array, n: int, model: Array, bit: int) -> int:
    split = min(max(4096 * model[0] // (model[0] + model[1]), 1), 4095)
    n = _put(items, n, split, 4096 - split) if bit else _put(items, n, 0, split)
    _adapt(model, bit)
    return n


@compiled
def _adapt(model: Array, bit: int) -> None:
    model[bit] += 2
    if model[0] + model[1] > 1020:
        model[0] = (model[0] + 1) >> 1
        model[1] = (model[1] + 1) >> 1


@compiled
def _put_value(items: Array, n: int, value: int, b: int) -> int:
    b = min(max(b, 0), _MOST_BIN)
    shift = 0
    if b > _TOP_BIN:
        shift = (b - _TOP_BIN + 3) >> 2
        b -= 4 * shift
    half = (1 << shift) >> 1
    high = (value + half) >> shift
    z = 2 * high if high >= 0 else -2 * high - 1
    if z < ESCAPE:
        n = _put(items, n, _STARTS[b, z], FREQUENCIES[b, z])
    else:
        n = _put(items, n, _STARTS[b, ESCAPE], FREQUENCIES[b, ESCAPE])
        rest = z - ESCAPE + 1
        width = 0
        while rest >> (width + 1):
            width += 1
            n = _put_raw(items, n, 1, 1)
        n = _put_raw(items, n, 0, 1)
        n = _put_raw(items, n, rest - (1 << width), width)
    return _put_raw(items, n, value + half - (high << shift), shift)


@compiled
def rans_encode(items: Array, n: int, lanes: int, words: Array) -> int:
    """Code `items[:n]` into the end of `words`; returns the index of the first word. n + 2 `lanes` words are enough."""
    x = np.full(lanes, LOWEST_STATE, np.int64)
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
def _begin(words: Array, x: Array, ctl: Array) -> None:
    if len(words) < 2 * len(x):
        ctl[2] = 1
        return
    for k in range(len(x)):
        x[k] = np.int64(words[2 * k]) | np.int64(words[2 * k + 1]) << 16
        if x[k] < LOWEST_STATE:
            ctl[2] = 1
    ctl[1] = 2 * len(x)


@compiled
def _finish(words: Array, x: Array, ctl: Array) -> bool:
    """Whether the stream ended as it must."""
    good = bool(ctl[2] == 0 and ctl[1] == len(words))
    for k in range(len(x)):
        good = good and bool(x[k] == LOWEST_STATE)
    return good


@compiled
def _slot(x: Array, ctl: Array) -> int:
    return int(x[ctl[0] & (len(x) - 1)] & 4095)


@compiled
def _take(words: Array, x: Array, ctl: Array, start: int, freq: int) -> None:
    k = ctl[0] & (len(x) - 1)
    state = freq * (x[k] >> 12) + (x[k] & 4095) - start
    if state < LOWEST_STATE:
        if ctl[1] < len(words):
            state = state << 16 | np.int64(words[ctl[1]])
            ctl[1] += 1
        else:
            ctl[2] = 1
            state = LOWEST_STATE
    x[k] = state
    ctl[0] += 1


@compiled
def _take_raw(words: Array, x: Array, ctl: Array, width: int) -> int:
    value, shift = 0, 0
    while width > 0:
        group = min(width, 12)
        bits = _slot(x, ctl) >> (12 - group)
        _take(words, x, ctl, bits << (12 - group), 1 << (12 - group))
        value |= bits << shift
        shift += group
        width -= group
    return value


@compiled
def _take_flag(words: Array, x: Array, ctl: Array, model: Array) -> int:
    split = min(max(4096 * model[0] // (model[0] + model[1]), 1), 4095)
    bit = 1 if _slot(x, ctl) >= split else 0
    if bit:
        _take(words, x, ctl, split, 4096 - split)
    else:
        _take(words, x, ctl, 0, split)
    _adapt(model, bit)
    return bit


@compiled
def _take_value(words: Array, x: Array, ctl: Array, b: int) -> int:
    b = min(max(b, 0), _MOST_BIN)
    shift = 0
    if b > _TOP_BIN:
        shift = (b - _TOP_BIN + 3) >> 2
        b -= 4 * shift
    z: Any = np.int64(_SYMBOL_OF[b * 4096 + _slot(x, ctl)])
    _take(words, x, ctl, _STARTS[b, z], FREQUENCIES[b, z])
    if z == ESCAPE:
        width = 0
        while _take_raw(words, x, ctl, 1):
            width += 1
            if width > _MOST_WIDTH or ctl[2]:
                ctl[2] = 1
                return 0
        z = ESCAPE - 1 + (1 << width) + _take_raw(words, x, ctl, width)
    high = -((z + 1) >> 1) if z & 1 else z >> 1
    value: Any = high
    if shift:
        value = (high << shift) - (1 << (shift - 1)) + _take_raw(words, x, ctl, shift)
    if abs(value) >= VALUE_LIMIT:
        ctl[2] = 1
        return 0
    return int(value)


# Columns, section 6.3.


@compiled
def _weights(scale: Array) -> tuple[Array, Array, Array, int]:
    """Channel bins, weights w and expectations u of channels with `scale` (0 for uncoded ones), and the sum of u."""
    bins, weight, expected = np.zeros_like(scale), np.zeros_like(scale), np.zeros_like(scale)
    for c in range(len(scale)):
        if scale[c]:
            bins[c] = magnitude_bin(scale[c])
            weight[c] = 65536 // (256 + scale[c])
            expected[c] = max(1, (weight[c] * scale[c] + 128) >> 8)
    return bins, weight, expected, expected.sum()


@compiled
def _renews(c: int) -> bool:
    """Whether the context is computed anew before channel c: 0, 4, 8, 16, 32, ..."""
    return c == 0 or (c >= 4 and c & (c - 1) == 0)


@compiled
def columns_items(values: Array, scale: Array, items: Array, n: int) -> int:
    """Model pass over `values` [rows, C]; appends to `items` at `n`."""
    bins, weight, expected, total = _weights(scale)
    if total == 0:
        return n
    mean = total
    for i in range(len(values)):
        energy, seen, gain = 0, 0, 0
        for c in range(len(scale)):
            if _renews(c):
                gain = magnitude_bin(256 * (6 * mean + energy) // (6 * total + seen)) - 24
            if scale[c]:
                value = values[i, c]
                n = _put_value(items, n, value, bins[c] + gain)
                energy += weight[c] * min(abs(value), ENERGY_LIMIT)
                seen += expected[c]
        mean += (energy - mean) >> 2
    return n


@compiled
def _take_columns(words: Array, x: Array, ctl: Array, values: Array, scale: Array) -> None:
    bins, weight, expected, total = _weights(scale)
    if total == 0:
        return
    mean, lanes = total, len(x) - 1
    item, at = ctl[0], ctl[1]  # kept apart from `ctl` on the common path, which this loop spells out for speed
    for i in range(len(values)):
        energy, seen, gain = 0, 0, 0
        for c in range(len(scale)):
            if _renews(c):
                gain = magnitude_bin(256 * (6 * mean + energy) // (6 * total + seen)) - 24
            if scale[c]:
                b = max(bins[c] + gain, 0)
                state = x[item & lanes]
                slot = state & 4095
                z: Any = np.int64(_SYMBOL_OF[min(b, _TOP_BIN) * 4096 + slot])
                if b <= _TOP_BIN and z < ESCAPE:
                    state = FREQUENCIES[b, z] * (state >> 12) + slot - _STARTS[b, z]
                    if state < LOWEST_STATE:
                        if at == len(words):
                            ctl[2] = 1
                            return
                        state = state << 16 | np.int64(words[at])
                        at += 1
                    x[item & lanes] = state
                    item += 1
                    value = -((z + 1) >> 1) if z & 1 else z >> 1
                else:
                    ctl[0], ctl[1] = item, at
                    value = _take_value(words, x, ctl, b)
                    item, at = ctl[0], ctl[1]
                values[i, c] = value
                energy += weight[c] * min(abs(value), ENERGY_LIMIT)
                seen += expected[c]
        mean += (energy - mean) >> 2
        if ctl[2]:
            return
    ctl[0], ctl[1] = item, at


@compiled
def decode_columns(words: Array, lanes: int, values: Array, scale: Array) -> bool:
    """Fill `values` [rows, C]; False if the stream is corrupt."""
    x, ctl = np.zeros(lanes, np.int64), np.zeros(3, np.int64)
    _begin(words, x, ctl)
    if ctl[2] == 0:
        _take_columns(words, x, ctl, values, scale)
    return _finish(words, x, ctl)


# Changes, section 9.


@compiled
def rows_items(changed: Array, items: Array, n: int) -> int:
    """Model pass over the set: `changed` [N] 0 or 1."""
    blocks, models = np.ones((BLOCK_MODELS, 2), np.int64), np.ones((ROW_MODELS, 2), np.int64)
    block_context, row_context = 0, 0
    for first in range(0, len(changed), BLOCK):
        block = changed[first : first + BLOCK]
        used = 1 if block.any() else 0
        n = _put_flag(items, n, blocks[block_context], used)
        block_context = (used << 1 | block_context >> 1) & 3
        if used:
            for bit in block:
                n = _put_flag(items, n, models[row_context], bit)
                row_context = bit << 2 | row_context >> 1
        else:
            row_context = 0
    return n


@compiled
def _take_rows(words: Array, x: Array, ctl: Array, changed: Array) -> int:
    blocks, models = np.ones((BLOCK_MODELS, 2), np.int64), np.ones((ROW_MODELS, 2), np.int64)
    block_context, row_context, count = 0, 0, 0
    for first in range(0, len(changed), BLOCK):
        used = _take_flag(words, x, ctl, blocks[block_context])
        block_context = (used << 1 | block_context >> 1) & 3
        if used:
            for i in range(first, min(first + BLOCK, len(changed))):
                bit = _take_flag(words, x, ctl, models[row_context])
                changed[i] = bit
                count += bit
                row_context = bit << 2 | row_context >> 1
        else:
            row_context = 0
        if ctl[2]:
            return count
    return count


@compiled
def _place(table: Array, voxel: Array, a: int, b: int, c: int, salt: Any) -> int:
    """Slot of `table` that holds, or would hold, the index of the row with voxel (a, b, c)."""
    h = np.uint64(a) * np.uint64(0x9E3779B97F4A7C15) ^ np.uint64(b) * np.uint64(0xC2B2AE3D27D4EB4F)
    h = (h ^ np.uint64(c) * np.uint64(0x165667B19E3779F9)) + salt  # salted: no stream can aim for collisions
    h = (h ^ h >> np.uint64(29)) * np.uint64(0xBF58476D1CE4E5B9)
    slot: Any = np.int64((h ^ h >> np.uint64(32)) & np.uint64(len(table) - 1))
    while True:
        row = table[slot]
        if row < 0 or (voxel[row, 0] == a and voxel[row, 1] == b and voxel[row, 2] == c):
            return int(slot)
        slot = (slot + 1) & (len(table) - 1)


@compiled
def _predict(table: Array, voxel: Array, delta: Array, i: int, salt: Any, prediction: Array) -> None:
    """Mean delta of the coded rows around voxel i, otherwise that of row i - 1; then row i enters the table."""
    found = 0
    prediction[:] = 0
    for a in range(-1, 2):
        for b in range(-1, 2):
            for c in range(-1, 2):
                row = table[_place(table, voxel, voxel[i, 0] + a, voxel[i, 1] + b, voxel[i, 2] + c, salt)]
                if row >= 0:
                    found += 1
                    prediction += delta[row]
    if found:
        for axis in range(3):
            prediction[axis] = (2 * prediction[axis] + found) // (2 * found)
    elif i > 0:
        prediction[:] = delta[i - 1]
    table[_place(table, voxel, voxel[i, 0], voxel[i, 1], voxel[i, 2], salt)] = i


@compiled
def _table_for(count: int) -> Array:
    size = 16
    while size < 2 * count:
        size *= 2
    return np.full(size, -1, np.int32)


@compiled
def position_errors(voxel: Array, delta: Array, salt: Any) -> Array:
    """[n,3] what prediction leaves of `delta` [n,3] for changed rows with `voxel` [n,3], all int64."""
    table, prediction, errors = _table_for(len(voxel)), np.zeros(3, np.int64), np.zeros_like(delta)
    for i in range(len(voxel)):
        _predict(table, voxel, delta, i, salt, prediction)
        errors[i] = delta[i] - prediction
    return errors


@compiled
def _position_bin(average: Array, s1: int, s2: int, within: int, axis: int) -> int:
    return magnitude_bin((6 * average[axis] + 6 * s1 + 4 * s2 + 9 * within) // (36 + 9 * axis))


@compiled
def positions_items(errors: Array, scale: int, items: Array, n: int) -> int:
    """Model pass over prediction errors [n,3]."""
    average = np.full(3, scale, np.int64)
    s1, s2 = 3 * scale, 3 * scale
    for i in range(len(errors)):
        within = 0
        for axis in range(3):
            n = _put_value(items, n, errors[i, axis], _position_bin(average, s1, s2, within, axis))
            size = 256 * abs(errors[i, axis])
            average[axis] += (size - average[axis]) >> 6
            within += size
        s1, s2 = within, s1
    return n


@compiled
def _take_positions(
    words: Array, x: Array, ctl: Array, voxel: Array, delta: Array, scale: int, predicted: bool, salt: Any
) -> None:
    table, prediction = _table_for(len(voxel)), np.zeros(3, np.int64)
    average = np.full(3, scale, np.int64)
    s1, s2 = 3 * scale, 3 * scale
    for i in range(len(voxel)):
        if predicted:
            _predict(table, voxel, delta, i, salt, prediction)
        within = 0
        for axis in range(3):
            error = _take_value(words, x, ctl, _position_bin(average, s1, s2, within, axis))
            delta[i, axis] = prediction[axis] + error
            if abs(delta[i, axis]) >= 1 << 31:
                ctl[2] = 1
            size = 256 * abs(error)
            average[axis] += (size - average[axis]) >> 6
            within += size
        s1, s2 = within, s1
        if ctl[2]:
            return


@compiled
def decode_change(
    words: Array, lanes: int, voxel: Array, position_scale: int, predicted: bool, scale: Array, salt: Any
) -> tuple[bool, Array, Array, Array]:
    """Whether the stream is sound; rows [n], position [n,3], latent [n,C], all int64."""
    x, ctl = np.zeros(lanes, np.int64), np.zeros(3, np.int64)
    changed = np.zeros(len(voxel), np.uint8)
    count = 0
    _begin(words, x, ctl)
    if ctl[2] == 0:
        count = _take_rows(words, x, ctl, changed)
    if ctl[2]:
        count = 0
    rows = np.zeros(count, np.int64)
    delta, latent = np.zeros((count, 3), np.int64), np.zeros((count, len(scale)), np.int64)
    at = np.zeros((count, 3), np.int64)
    n = 0
    for i in range(len(changed)):
        if changed[i] and n < count:
            rows[n] = i
            for axis in range(3):
                at[n, axis] = voxel[i, axis]
            n += 1
    if ctl[2] == 0:
        _take_positions(words, x, ctl, at, delta, position_scale, predicted, salt)
    if ctl[2] == 0:
        _take_columns(words, x, ctl, latent, scale)
    return _finish(words, x, ctl), rows, delta, latent


# Octree, section 7.


@compiled
def _octree_model(depth: int, d: int, parent: int, prefix: int) -> int:
    return ((min(depth - 1 - d, 3) * 4 + parent) << 8) | prefix


@compiled
def _parent_class(children: int) -> int:
    return 0 if children <= 1 else 1 if children == 2 else 2 if children <= 4 else 3


@compiled
def octree_items(keys: Array, depth: int, items: Array, n: int) -> int:
    """Model pass over strictly ascending Morton `keys` of `depth` bits an axis."""
    models = np.ones((OCTREE_MODELS, 2), np.int64)
    parents = np.zeros(1, np.int64)
    for d in range(depth):
        shift = 3 * (depth - 1 - d)
        classes = np.zeros(len(keys), np.int64)
        i, node, born = 0, 0, 0
        while i < len(keys):
            occupancy, children = 0, 0
            parent_key = keys[i] >> (shift + 3)
            while i < len(keys) and keys[i] >> (shift + 3) == parent_key:
                child = (keys[i] >> shift) & 7
                if not occupancy >> child & 1:
                    occupancy |= 1 << child
                    children += 1
                i += 1
            prefix = 1
            for j in range(8):
                bit = occupancy >> j & 1
                if j < 7 or prefix != 1 << 7:
                    n = _put_flag(items, n, models[_octree_model(depth, d, parents[node], prefix)], bit)
                prefix = 2 * prefix + bit
            for _ in range(children):
                classes[born] = _parent_class(children)
                born += 1
            node += 1
        parents = classes
    return n


@compiled
def decode_octree(words: Array, lanes: int, depth: int, count: int) -> tuple[bool, Array]:
    """Whether the stream is sound, and [count,3] int64 nodes."""
    x, ctl = np.zeros(lanes, np.int64), np.zeros(3, np.int64)
    models = np.ones((OCTREE_MODELS, 2), np.int64)
    nodes, parents = np.zeros((1, 3), np.int64), np.zeros(1, np.int64)
    _begin(words, x, ctl)
    for d in range(depth):
        room = min(count, 8 * len(nodes))
        children, classes = np.zeros((room, 3), np.int64), np.zeros(room, np.int64)
        born = 0
        for node in range(len(nodes)):
            prefix, first = 1, born
            for j in range(8):
                bit = 1
                if j < 7 or prefix != 1 << 7:
                    bit = _take_flag(words, x, ctl, models[_octree_model(depth, d, parents[node], prefix)])
                prefix = 2 * prefix + bit
                if bit:
                    if born == room:
                        ctl[2] = 1
                        break
                    children[born, 0] = 2 * nodes[node, 0] + (j >> 2)
                    children[born, 1] = 2 * nodes[node, 1] + (j >> 1 & 1)
                    children[born, 2] = 2 * nodes[node, 2] + (j & 1)
                    born += 1
            if ctl[2]:
                return False, np.zeros((0, 3), np.int64)
            classes[first:born] = _parent_class(born - first)
        nodes, parents = children[:born].copy(), classes[:born].copy()
    return _finish(words, x, ctl) and len(nodes) == count, nodes
