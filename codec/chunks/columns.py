"""Rows of integers under rANS, in classes of precision with an energy context. FORMAT.md sections 6.3, 6.4, 8, 10."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from streamlod.codec.coder import class_model
from streamlod.codec.coder.entropy import corrupt, decode_scales, encode_items, encode_scales, words_of
from streamlod.codec.coder.rans import MAX_VALUE
from streamlod.codec.coder.trend import restore, trend_errors
from streamlod.core.arrays import Int32, Int64
from streamlod.core.errors import BitstreamError
from streamlod.core.scene.quantise import trailing_zeros

_AS_IS, _CENTRED, _TREND = 0, 1, 2
_COUNT = struct.Struct("<I")
BEHIND_COUNT = 1 + _COUNT.size  # where the fields of a chunk with a row count begin
_MIN_CLASS_ROWS = 16  # rows that are worth a class of their own


def encode(matrix: Int64, shifted: slice, *, with_count: bool = False) -> bytes | None:
    """The chunk of `matrix` [n,C], or None if a number is too large for it.

    Rows whose channels `shifted` are all multiples of a power of two are sent without those zeros at the end, in a
    class of their own. Each channel is sent as it is, around a centre, or as difference to the mean of the last rows,
    whichever is smallest.
    """
    modes, centre, used, classes, values = classed(matrix, shifted)
    if np.abs(values).max(initial=0) > MAX_VALUE:
        return None
    coded = [encode_scales(values[classes == k]) for k in range(len(used))]
    scales = np.stack([scale for _, scale in coded])
    lanes, words = encode_items(
        lambda items: class_model.rows_items(values, classes, scales, items, 0), 2 * values.size + 2 * len(values)
    )
    centres: bytes = centre[modes == _CENTRED].astype("<i4").tobytes()
    count = _COUNT.pack(len(matrix)) if with_count else b""
    mask = bytes([int((1 << used).sum())])
    sides = b"".join(side for side, _ in coded)
    return bytes([lanes]) + count + _pack_modes(modes) + centres + mask + sides + words


def classed(matrix: Int64, shifted: slice) -> tuple[Int64, Int64, Int64, Int64, Int64]:
    """Parts of `matrix` [n,C]: modes [C], centres [C], shifts in use, class of each row [n], numbers left [n,C]."""
    shifts = _shifts(matrix[:, shifted])
    used = np.unique(shifts) if len(shifts) else np.zeros(1, np.int64)
    scaled = _in_range(matrix.shape[1], shifted)
    modes, centre, values = _formed(matrix, int(used[-1]), scaled)
    values = values >> (shifts[:, None] * scaled)
    for c in range(matrix.shape[1]):
        errors = trend_errors(matrix[:, c].copy(), shifts * scaled[c])
        if np.log2(1.0 + np.abs(errors)).sum() < np.log2(1.0 + np.abs(values[:, c])).sum():
            modes[c], values[:, c] = _TREND, errors
    return modes, centre, used, np.searchsorted(used, shifts), values


def _formed(matrix: Int64, most: int, scaled: Int64) -> tuple[Int64, Int64, Int64]:
    """Each channel's mode and centre, and the values [n,C] that are left; multiples of 2^`most` stay multiples."""
    unit = 1 << most * scaled
    centre = np.asarray(np.round(np.median(matrix, axis=0) / unit), np.int64) * unit
    forms = np.stack([matrix, matrix - centre])
    sizes: NDArray[np.float64] = np.log2(1.0 + np.abs(forms)).sum(axis=1)
    sizes[_CENTRED] += 32  # the bits of a centre
    modes: Int64 = np.argmin(sizes, axis=0).astype(np.int64)
    return modes, centre, np.asarray(np.take_along_axis(forms, modes[None, None], axis=0)[0], np.int64)


def _shifts(matrix: Int64) -> Int64:
    """[n] how many zeros end every number of a row, in steps that enough rows share."""
    shifts = trailing_zeros(matrix, class_model.MAX_CLASSES - 1)
    counts = np.bincount(shifts, minlength=class_model.MAX_CLASSES)
    for shift in range(class_model.MAX_CLASSES - 1, 0, -1):
        if 0 < counts[shift] < _MIN_CLASS_ROWS:
            shifts[shifts == shift] -= 1
            counts[shift - 1] += counts[shift]
    return shifts


def _in_range(channels: int, shifted: slice) -> Int64:
    """[C] 1 for the channels of `shifted`."""
    scaled = np.zeros(channels, np.int64)
    scaled[shifted] = 1
    return scaled


def decode(data: bytes, at: int, rows: int, channels: int, shifted: slice) -> Int32:
    """[rows, channels] of a chunk whose fields begin at byte `at`; BitstreamError `corrupt_chunk` or `overflow`."""
    lanes = data[0]
    modes, at = _unpack_modes(data, at, channels)
    centred = np.flatnonzero(modes == _CENTRED)
    if len(data) < at + 4 * len(centred):
        raise corrupt("a chunk ends inside its centres")
    centres = np.zeros(channels, np.int64)
    centres[centred] = np.frombuffer(data, "<i4", len(centred), at)
    used, at = _unpack_classes(data, at + 4 * len(centred))
    scales = np.zeros((len(used), channels), np.int64)
    for k in range(len(used)):
        scales[k], at = decode_scales(data, at, channels)
    values, classes = np.zeros((rows, channels), np.int32), np.zeros(rows, np.uint8)
    if not class_model.decode_rows(words_of(data, at), lanes, values, classes, scales):
        raise corrupt("an entropy-coded chunk does not end as it must")
    if not restore(values, used[classes], _in_range(channels, shifted), modes, centres):
        raise BitstreamError("overflow", "a number leaves the range of its column")
    return values


def _unpack_classes(data: bytes, at: int) -> tuple[Int64, int]:
    """The shifts in use, ascending, and where what follows begins."""
    if len(data) <= at or data[at] == 0:
        raise corrupt("a chunk has no class of rows")
    return np.flatnonzero(data[at] >> np.arange(class_model.MAX_CLASSES) & 1), at + 1


def _pack_modes(modes: Int64) -> bytes:
    padded = np.append(modes, [0] * (-len(modes) % 4)).astype(np.uint8).reshape(-1, 4)
    return bytes((padded << np.array([0, 2, 4, 6], np.uint8)).sum(axis=1).tolist())


def _unpack_modes(data: bytes, at: int, channels: int) -> tuple[Int64, int]:
    end = at + (channels + 3) // 4
    if len(data) < end:
        raise corrupt("a chunk ends inside its channel modes")
    packed = np.frombuffer(data, np.uint8, end - at, at)
    modes = (packed[:, None] >> np.array([0, 2, 4, 6], np.uint8) & 3).reshape(-1).astype(np.int64)
    if modes[channels:].any() or (modes > _TREND).any():
        raise corrupt("a channel mode is unknown, or an unused one is not zero")
    return modes[:channels], end
