"""Chunks of one level: the choice of coding, around the coders themselves. FORMAT.md sections 6 to 10."""

from __future__ import annotations

import numpy as np

from streamlod.codec.chunks import change, columns, geometry, plain
from streamlod.codec.chunks.change import Elapsed
from streamlod.codec.chunks.matrices import (
    added_channels,
    added_matrix,
    base_channels,
    base_matrix,
    level_from_added,
    level_from_base,
    shifted_channels,
    shifted_of,
)
from streamlod.codec.packet.limits import Room
from streamlod.core.arrays import Bool, Int32, Int64
from streamlod.core.errors import BitstreamError
from streamlod.core.scene.anchors import LATENTS, AnchorLevel, SceneHeader

CHANGE_COLUMNS = 1 + 3 + LATENTS
_ENTROPY_CODINGS = (1, 4)


def coding_of(data: bytes, profile: int, *, plain_only: bool = False) -> int:
    """The coding that a chunk's first byte names; BitstreamError `unsupported_profile` if it may not occur there."""
    if not data:
        raise BitstreamError("corrupt_chunk", "a chunk is empty")
    if data[0] != plain.CODING and (profile == 0 or plain_only or data[0] not in _ENTROPY_CODINGS):
        raise BitstreamError("unsupported_profile", f"coding {data[0]} cannot occur here")
    return data[0]


def encode_geometry(level: AnchorLevel, profile: int) -> bytes:
    """The GEOMETRY chunk of a level that has anchors."""
    coded = geometry.encode(level.voxel) if profile else None
    if coded is not None:
        return coded
    voxel = level.voxel.view(np.uint32)  # differences modulo 2^32, as they are added again
    steps = voxel - np.concatenate([np.zeros((1, 3), np.uint32), voxel[:-1]])
    return plain.encode_plain(steps.view(np.int32))


def decode_geometry(data: bytes, profile: int, room: Room) -> Int32:
    """[N,3] voxels of a GEOMETRY chunk."""
    if coding_of(data, profile):
        return geometry.decode(data, room)
    room.check_added(plain.row_count(data), 3)
    return np.cumsum(plain.decode_plain(data, 3), axis=0, dtype=np.int32)


def encode_base(level: AnchorLevel, profile: int) -> bytes:
    """The BASE chunk of a level that has anchors."""
    matrix = base_matrix(level)
    coded = columns.encode(matrix, shifted_of(level)) if profile else None
    return plain.encode_plain(matrix) if coded is None else coded


def decode_base(data: bytes, profile: int, header: SceneHeader, voxel: Int32, room: Room) -> AnchorLevel:
    """The level of a BASE chunk and its voxels."""
    channels, coding = base_channels(header), coding_of(data, profile)
    if coding == plain.CODING and plain.row_count(data) != len(voxel):
        raise BitstreamError("corrupt_chunk", f"{plain.row_count(data)} base rows for {len(voxel)} voxels")
    room.check(len(voxel), channels)
    if coding:
        return level_from_base(header, voxel, columns.decode(data, 1, len(voxel), channels, shifted_channels(header)))
    return level_from_base(header, voxel, plain.decode_plain(data, channels))


def encode_change(
    level: AnchorLevel, rows: Int64, position: Int64, latent: Int64, elapsed: Elapsed, profile: int
) -> bytes:
    """The CHANGE chunk: `rows` of `level`, as it was before, change by `position` [n,3] and `latent` [n,24]."""
    coded = change.encode(level, rows, position, latent, elapsed) if profile else None
    if coded is not None:
        return coded
    return plain.encode_plain(np.concatenate([_gaps(rows)[:, None], position, latent], axis=1))


def decode_change(
    data: bytes, profile: int, level: AnchorLevel, elapsed: Elapsed, room: Room
) -> tuple[Int64, Int32, Int32]:
    """Rows [n], position [n,3] and latent [n,24] differences of a CHANGE chunk for `level` as it was before."""
    if coding_of(data, profile):
        return change.decode(data, level, elapsed)
    _check_existing(plain.row_count(data), CHANGE_COLUMNS, len(level), room)
    matrix = plain.decode_plain(data, CHANGE_COLUMNS)
    return _rows(matrix[:, 0], len(level)), matrix[:, 1:4].copy(), matrix[:, 4:].copy()


def encode_removed(rows: Int64) -> bytes:
    """The REMOVED chunk."""
    return plain.encode_plain(_gaps(rows)[:, None])


def decode_removed(data: bytes, profile: int, alive: Bool, room: Room) -> Int64:
    """Rows of a REMOVED chunk of a level whose rows are `alive` [N] before."""
    coding_of(data, profile, plain_only=True)
    _check_existing(plain.row_count(data), 1, len(alive), room)
    rows = _rows(plain.decode_plain(data, 1)[:, 0], len(alive))
    if not alive[rows].all():
        raise BitstreamError("corrupt_chunk", "a row that was removed before cannot be removed again")
    return rows


def _check_existing(rows: int, columns: int, held: int, room: Room) -> None:
    """Refuse a table of more rows than the level has, `held`, or with too few bytes behind it."""
    if rows > held:
        raise BitstreamError("corrupt_chunk", f"{rows} rows of a level that has {held}")
    room.check(rows, columns)


def encode_added(level: AnchorLevel, profile: int) -> bytes:
    """The ADDED chunk."""
    matrix = added_matrix(level)
    deflated = plain.encode_plain(matrix)
    coded = columns.encode(matrix, shifted_of(level, 3), with_count=True) if profile else None
    return deflated if coded is None else min(deflated, coded, key=len)


def decode_added(data: bytes, profile: int, header: SceneHeader, room: Room) -> AnchorLevel:
    """The rows of an ADDED chunk."""
    channels, coding, rows = added_channels(header), coding_of(data, profile), plain.row_count(data)
    room.check_added(rows, channels)
    if coding:
        matrix = columns.decode(data, columns.BEHIND_COUNT, rows, channels, shifted_channels(header, 3))
    else:
        matrix = plain.decode_plain(data, channels)
    return level_from_added(header, matrix)


def _gaps(rows: Int64) -> Int64:
    return np.diff(rows, prepend=0)


def _rows(gaps: Int32, count: int) -> Int64:
    rows = np.cumsum(gaps, dtype=np.int64)
    if len(rows) and (gaps[0] < 0 or (gaps[1:] <= 0).any() or rows[-1] >= count):
        raise BitstreamError("corrupt_chunk", f"row numbers do not ascend below {count}")
    return rows
