"""Rows of integers under rANS with an energy context. FORMAT.md sections 6.3, 8 and 10."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from codec import column_model
from codec.entropy import corrupt, decode_scales, encode_items, encode_scales, words_of
from codec.rans import VALUE_LIMIT
from core.arrays import Int64
from core.errors import BitstreamError

_AS_IS, _CENTRED, _PREVIOUS = 0, 1, 2
_COUNT = struct.Struct("<I")


def encode(matrix: Int64, *, with_count: bool = False) -> bytes | None:
    """The chunk of `matrix` [n,C], or None if a number is too large for it.

    Each channel is sent as it is, around a centre, or as difference to the row before, whichever is smallest.
    """
    centre = np.asarray(np.round(np.median(matrix, axis=0)), np.int64)
    previous = np.diff(matrix, axis=0, prepend=0)
    forms = np.stack([matrix, matrix - centre, previous])
    sizes: NDArray[np.float64] = np.log2(1.0 + np.abs(forms)).sum(axis=1)
    sizes += 32 * (np.arange(3)[:, None] == _CENTRED)  # the bits of a centre
    modes: Int64 = np.argmin(sizes, axis=0).astype(np.int64)
    values = np.asarray(np.take_along_axis(forms, modes[None, None], axis=0)[0], np.int64)
    if np.abs(values).max(initial=0) >= VALUE_LIMIT:
        return None
    side, scale = encode_scales(values)
    lanes, words = encode_items(lambda items: column_model.columns_items(values, scale, items, 0), 2 * values.size)
    centres: bytes = centre[modes == _CENTRED].astype("<i4").tobytes()
    count = _COUNT.pack(len(matrix)) if with_count else b""
    return bytes([lanes]) + count + _pack_modes(modes) + centres + side + words


def decode(data: bytes, at: int, rows: int, channels: int) -> Int64:
    """[rows, channels] of a chunk whose fields begin at byte `at`; BitstreamError `corrupt_chunk`."""
    lanes = data[0]
    modes, at = _unpack_modes(data, at, channels)
    centred = np.flatnonzero(modes == _CENTRED)
    if len(data) < at + 4 * len(centred):
        raise corrupt("a chunk ends inside its centres")
    centres = np.frombuffer(data, "<i4", len(centred), at).astype(np.int64)
    scale, at = decode_scales(data, at + 4 * len(centred), channels)
    values = np.zeros((rows, channels), np.int64)
    if not column_model.decode_columns(words_of(data, at), lanes, values, scale):
        raise corrupt("an entropy-coded chunk does not end as it must")
    values[:, centred] += centres
    following = modes == _PREVIOUS
    values[:, following] = np.cumsum(values[:, following], axis=0)
    return values


def decode_counted(data: bytes, most_rows: int, channels: int) -> Int64:
    """[n, channels] of a chunk that begins with its row count; also `limit_exceeded`."""
    if len(data) < 1 + _COUNT.size:
        raise corrupt("a chunk ends before its row count")
    (rows,) = _COUNT.unpack_from(data, 1)
    if rows > most_rows:
        raise BitstreamError("limit_exceeded", f"{rows} rows exceed the limit of {most_rows}")
    return decode(data, 1 + _COUNT.size, rows, channels)


def _pack_modes(modes: Int64) -> bytes:
    padded = np.append(modes, [0] * (-len(modes) % 4)).astype(np.uint8).reshape(-1, 4)
    return bytes((padded << np.array([0, 2, 4, 6], np.uint8)).sum(axis=1).tolist())


def _unpack_modes(data: bytes, at: int, channels: int) -> tuple[Int64, int]:
    end = at + (channels + 3) // 4
    if len(data) < end:
        raise corrupt("a chunk ends inside its channel modes")
    packed = np.frombuffer(data, np.uint8, end - at, at)
    modes = (packed[:, None] >> np.array([0, 2, 4, 6], np.uint8) & 3).reshape(-1).astype(np.int64)
    if (modes > _PREVIOUS).any() or modes[channels:].any():
        raise corrupt("a channel mode is not known")
    return modes[:channels], end
