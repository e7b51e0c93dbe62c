"""The dynamic set, position and latent differences, as compiled loops. FORMAT.md section 9."""

from __future__ import annotations

from typing import Any

import numpy as np

from codec.column_model import columns_items, take_columns
from codec.compiled import compiled
from codec.rans import Array, begin, finish, magnitude_bin, put_flag, put_value, take_flag, take_value

BLOCK = 64
BLOCK_MODELS, ROW_MODELS, LATENT_MODELS = 8, 16, 4


@compiled
def rows_with_any(values: Array) -> Array:
    """[N] uint8: 1 where any of a row of `values` [N,C] is not 0."""
    found = np.zeros(len(values), np.uint8)
    for i in range(len(values)):
        for value in values[i]:
            found[i] |= value != 0
    return found


@compiled
def _any(touched: Array, first: int) -> int:
    """Whether a row of the block from `first` was touched."""
    return 1 if touched[first : first + BLOCK].any() else 0


@compiled
def rows_items(changed: Array, touched: Array, items: Array, n: int) -> int:
    """Model pass over the set: `changed` [N] 0 or 1, `touched` [N] 1 for rows that changed since the keyframe."""
    blocks, models = np.ones((BLOCK_MODELS, 2), np.int64), np.ones((ROW_MODELS, 2), np.int64)
    block_context, row_context = 0, 0
    for first in range(0, len(changed), BLOCK):
        block = changed[first : first + BLOCK]
        used = 1 if block.any() else 0
        n = put_flag(items, n, blocks[4 * _any(touched, first) + block_context], used)
        block_context = (used << 1 | block_context >> 1) & 3
        if used:
            for i in range(len(block)):
                bit = block[i]
                n = put_flag(items, n, models[8 * touched[first + i] + row_context], bit)
                row_context = bit << 2 | row_context >> 1
        else:
            row_context = 0
    return n


@compiled
def _take_rows(words: Array, x: Array, ctl: Array, touched: Array, changed: Array) -> int:
    blocks, models = np.ones((BLOCK_MODELS, 2), np.int64), np.ones((ROW_MODELS, 2), np.int64)
    block_context, row_context, count = 0, 0, 0
    for first in range(0, len(changed), BLOCK):
        used = take_flag(words, x, ctl, blocks[4 * _any(touched, first) + block_context])
        block_context = (used << 1 | block_context >> 1) & 3
        if used:
            for i in range(first, min(first + BLOCK, len(changed))):
                bit = take_flag(words, x, ctl, models[8 * touched[i] + row_context])
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
            n = put_value(items, n, errors[i, axis], _position_bin(average, s1, s2, within, axis))
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
            error = take_value(words, x, ctl, _position_bin(average, s1, s2, within, axis))
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
def latents_items(latent: Array, used: Array, scale: Array, items: Array, n: int) -> int:
    """Model pass over latent differences [n,C]: which rows have any, then those.

    Args:
        used: [n] 1 for rows whose latents were not all 0 before.
    """
    models = np.ones((LATENT_MODELS, 2), np.int64)
    chosen = np.zeros(len(latent), np.bool_)
    before = 0
    for i in range(len(latent)):
        own = 1 if latent[i].any() else 0
        n = put_flag(items, n, models[2 * before + used[i]], own)
        chosen[i] = own == 1
        before = own
    return columns_items(latent[chosen], scale, items, n)


@compiled
def _take_latents(words: Array, x: Array, ctl: Array, used: Array, latent: Array, scale: Array) -> None:
    models = np.ones((LATENT_MODELS, 2), np.int64)
    chosen = np.zeros(len(latent), np.bool_)
    before = 0
    for i in range(len(latent)):
        before = take_flag(words, x, ctl, models[2 * before + used[i]])
        chosen[i] = before == 1
    if ctl[2]:
        return
    rows = np.flatnonzero(chosen)
    part = np.zeros((len(rows), latent.shape[1]), np.int64)
    take_columns(words, x, ctl, part, scale)
    for k in range(len(rows)):
        for c in range(latent.shape[1]):
            latent[rows[k], c] = part[k, c]


@compiled
def decode_change(
    words: Array,
    lanes: int,
    voxel: Array,
    touched: Array,
    used: Array,
    position_scale: int,
    predicted: bool,
    scale: Array,
    salt: Any,
) -> tuple[bool, Array, Array, Array]:
    """Whether the stream is sound; rows [n], position [n,3], latent [n,C], all int64.

    Args:
        touched, used: [N] 1 for rows, and for rows' latents, that are not all 0 before.
    """
    x, ctl = np.zeros(lanes, np.int64), np.zeros(3, np.int64)
    changed = np.zeros(len(voxel), np.uint8)
    count = 0
    begin(words, x, ctl)
    if ctl[2] == 0:
        count = _take_rows(words, x, ctl, touched, changed)
    if ctl[2]:
        count = 0
    rows = np.zeros(count, np.int64)
    delta, latent = np.zeros((count, 3), np.int64), np.zeros((count, len(scale)), np.int64)
    at, with_latents = np.zeros((count, 3), np.int64), np.zeros(count, np.uint8)
    n = 0
    for i in range(len(changed)):
        if changed[i] and n < count:
            rows[n] = i
            with_latents[n] = used[i]
            for axis in range(3):
                at[n, axis] = voxel[i, axis]
            n += 1
    if ctl[2] == 0:
        _take_positions(words, x, ctl, at, delta, position_scale, predicted, salt)
    if ctl[2] == 0:
        _take_latents(words, x, ctl, with_latents, latent, scale)
    return finish(words, x, ctl), rows, delta, latent
