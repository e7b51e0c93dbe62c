"""The dynamic set, position and latent differences, as compiled loops. FORMAT.md section 9."""

from __future__ import annotations

import numpy as np

from streamlod.codec.coder.column_model import columns_items, take_columns
from streamlod.codec.coder.compiled import compiled
from streamlod.codec.coder.rans import Array, begin, finish, magnitude_bin, put_flag, put_value, take_flag, take_value

BLOCK = 64
BLOCK_MODELS, ROW_MODELS, LATENT_MODELS = 8, 16, 2
MAX_SPAN = 255  # frames; steady motion over more counts as over these


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
    """Decode `changed` [N]; returns how many are 1."""
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
def steady_motion(position: Array, rows: Array, age: int, span: int) -> Array:
    """[n,3] int64 motion of `rows` in the next `span` frames, in 1/128 step, at their mean speed since the keyframe.

    Args:
        position: [N,3] difference from the keyframe, `age` frames ago.
    """
    motion = np.zeros((len(rows), 3), np.int64)
    frames = min(span, age, MAX_SPAN)  # no extrapolation over more frames than were seen
    if age > 0:
        for i in range(len(rows)):
            for axis in range(3):
                motion[i, axis] = 128 * np.int64(position[rows[i], axis]) * frames // age
    return motion


@compiled
def _prediction(motion: int, trend: int) -> int:
    """Steps to expect: half of the steady motion plus a quarter of the running mean `trend`, which is in 1/64 step."""
    return (motion + trend + 128) >> 8


@compiled
def _followed(trend: int, delta: int) -> int:
    """The running mean after another difference."""
    return trend + 16 * delta - (trend >> 2)


@compiled
def position_errors(delta: Array, motion: Array) -> Array:
    """[n,3] prediction errors of `delta` [n,3] for rows with steady motion `motion` [n,3]; all int64."""
    trend, errors = np.zeros(3, np.int64), np.zeros_like(delta)
    for i in range(len(delta)):
        for axis in range(3):
            errors[i, axis] = delta[i, axis] - _prediction(motion[i, axis], trend[axis])
            trend[axis] = _followed(trend[axis], delta[i, axis])
    return errors


@compiled
def _size(row: Array) -> int:
    """Sum of the magnitudes of three numbers."""
    return int(abs(row[0]) + abs(row[1]) + abs(row[2]))


@compiled
def _position_bin(average: int, before: int, mean: int, within: int, motion: int, axis: int) -> int:
    """Bin of a position's error, by the errors of its axis, of the row before, of all rows so far and of its row."""
    return magnitude_bin((4 * (average + motion) + before + 3 * mean + 6 * within) // (18 + 6 * axis))


@compiled
def positions_items(errors: Array, motion: Array, scale: int, items: Array, n: int) -> int:
    """Model pass over prediction errors [n,3] of rows whose steady motion is `motion` [n,3]."""
    average = np.full(3, scale, np.int64)
    before, mean = 3 * scale, 3 * scale
    for i in range(len(errors)):
        within, steady = 0, _size(motion[i])
        for axis in range(3):
            n = put_value(items, n, errors[i, axis], _position_bin(average[axis], before, mean, within, steady, axis))
            size = 256 * abs(errors[i, axis])
            average[axis] += (size - average[axis]) >> 6
            within += size
        before = within
        mean += (within - mean) >> 3
    return n


@compiled
def _take_positions(words: Array, x: Array, ctl: Array, motion: Array, delta: Array, scale: int) -> None:
    """Decode `delta` [n,3] of rows with steady motion `motion` [n,3]."""
    average, trend = np.full(3, scale, np.int64), np.zeros(3, np.int64)
    before, mean = 3 * scale, 3 * scale
    for i in range(len(delta)):
        within, steady = 0, _size(motion[i])
        for axis in range(3):
            error = take_value(words, x, ctl, _position_bin(average[axis], before, mean, within, steady, axis))
            delta[i, axis] = _prediction(motion[i, axis], trend[axis]) + error
            if abs(delta[i, axis]) >= 1 << 31:
                ctl[2] = 1
            if ctl[2]:
                return
            trend[axis] = _followed(trend[axis], delta[i, axis])
            size = 256 * abs(error)
            average[axis] += (size - average[axis]) >> 6
            within += size
        before = within
        mean += (within - mean) >> 3


@compiled
def latents_items(latent: Array, before: Array, scale: Array, items: Array, n: int) -> int:
    """Model pass over latent differences [n,C] of rows with latents `before` [n,C]: which are not 0, then these."""
    models = np.ones((LATENT_MODELS, 2), np.int64)
    used, chosen = rows_with_any(before), np.zeros(len(latent), np.bool_)
    for i in range(len(latent)):
        chosen[i] = latent[i].any()
        n = put_flag(items, n, models[used[i]], 1 if chosen[i] else 0)
    return columns_items(latent[chosen], scale, items, n)


@compiled
def _take_latents(words: Array, x: Array, ctl: Array, before: Array, latent: Array, scale: Array) -> None:
    """Decode `latent` [n,C] of rows with latents `before` [n,C]."""
    models = np.ones((LATENT_MODELS, 2), np.int64)
    used, chosen = rows_with_any(before), np.zeros(len(latent), np.bool_)
    for i in range(len(latent)):
        chosen[i] = take_flag(words, x, ctl, models[used[i]]) == 1
    if ctl[2]:
        return
    take_columns(words, x, ctl, latent, np.flatnonzero(chosen), scale)


@compiled
def decode_change(
    words: Array,
    lanes: int,
    position_before: Array,
    latent_before: Array,
    touched: Array,
    position_scale: int,
    scale: Array,
    age: int,
    span: int,
) -> tuple[bool, Array, Array, Array]:
    """(whether the stream is sound, rows [n], position differences [n,3], latent differences [n,C] int32), else int64.

    Args:
        position_before, latent_before: [N,3] and [N,C] of the level before.
        touched: [N] 1 for rows where these are not all 0.
        age: frames from the keyframe to the level before; span: from there to the level after.
    """
    x, ctl = np.zeros(lanes, np.int64), np.zeros(3, np.int64)
    changed = np.zeros(len(touched), np.uint8)
    count = 0
    begin(words, x, ctl)
    if ctl[2] == 0:
        count = _take_rows(words, x, ctl, touched, changed)
    if ctl[2]:
        count = 0
    rows = np.zeros(count, np.int64)
    delta, latent = np.zeros((count, 3), np.int64), np.zeros((count, len(scale)), np.int32)
    n = 0
    for i in range(len(changed)):
        if changed[i] and n < count:
            rows[n] = i
            n += 1
    if ctl[2] == 0:
        motion = steady_motion(position_before, rows, age, span)
        _take_positions(words, x, ctl, motion, delta, position_scale)
    if ctl[2] == 0:
        _take_latents(words, x, ctl, latent_before[rows], latent, scale)
    return finish(words, x, ctl), rows, delta, latent
