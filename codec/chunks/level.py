"""Chunks of one level: the choice of coding, around the coders themselves. FORMAT.md sections 6 to 10."""

from __future__ import annotations

import numpy as np

from codec.chunks import change, columns, geometry, plain
from codec.chunks.change import Elapsed
from codec.chunks.matrices import (
    added_channels,
    added_matrix,
    base_channels,
    base_matrix,
    level_from_added,
    level_from_base,
    shifted_channels,
    shifted_of,
)
from core.arrays import Int32, Int64
from core.errors import BitstreamError
from core.scene.anchors import LATENTS, AnchorLevel, SceneHeader

_CHANGE_COLUMNS = 1 + 3 + LATENTS
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


def decode_geometry(data: bytes, profile: int, most_rows: int) -> Int32:
    """[N,3] voxels of a GEOMETRY chunk."""
    if coding_of(data, profile):
        return geometry.decode(data, most_rows)
    steps = plain.decode_plain(data, 3, most_rows)
    return np.cumsum(steps, axis=0, dtype=np.int32)


def encode_base(level: AnchorLevel, profile: int) -> bytes:
    """The BASE chunk of a level that has anchors."""
    matrix = base_matrix(level)
    coded = columns.encode(matrix, shifted_of(level)) if profile else None
    return plain.encode_plain(matrix) if coded is None else coded


def decode_base(data: bytes, profile: int, header: SceneHeader, voxel: Int32) -> AnchorLevel:
    """The level of a BASE chunk and its voxels."""
    channels = base_channels(header)
    if coding_of(data, profile):
        return level_from_base(header, voxel, columns.decode(data, 1, len(voxel), channels, shifted_channels(header)))
    matrix = plain.decode_plain(data, channels, len(voxel))
    if len(matrix) != len(voxel):
        raise BitstreamError("corrupt_chunk", f"{len(matrix)} base rows for {len(voxel)} voxels")
    return level_from_base(header, voxel, matrix.astype(np.int64))


def encode_change(
    level: AnchorLevel, rows: Int64, position: Int64, latent: Int64, elapsed: Elapsed, profile: int
) -> bytes:
    """The CHANGE chunk: `rows` of `level`, as it was before, change by `position` [n,3] and `latent` [n,24]."""
    coded = change.encode(level, rows, position, latent, elapsed) if profile else None
    if coded is not None:
        return coded
    return plain.encode_plain(np.concatenate([_gaps(rows)[:, None], position, latent], axis=1))


def decode_change(data: bytes, profile: int, level: AnchorLevel, elapsed: Elapsed) -> tuple[Int64, Int32, Int32]:
    """Rows [n], position [n,3] and latent [n,24] differences of a CHANGE chunk for `level` as it was before."""
    if coding_of(data, profile):
        return change.decode(data, level, elapsed)
    matrix = plain.decode_plain(data, _CHANGE_COLUMNS, len(level))
    return _rows(matrix[:, 0], len(level)), matrix[:, 1:4].copy(), matrix[:, 4:].copy()


def encode_removed(rows: Int64) -> bytes:
    """The REMOVED chunk."""
    return plain.encode_plain(_gaps(rows)[:, None])


def decode_removed(data: bytes, profile: int, count: int) -> Int64:
    """Rows of a REMOVED chunk of a level with `count` rows."""
    coding_of(data, profile, plain_only=True)
    return _rows(plain.decode_plain(data, 1, count)[:, 0], count)


def encode_added(level: AnchorLevel, profile: int) -> bytes:
    """The ADDED chunk."""
    matrix = added_matrix(level)
    candidates = [plain.encode_plain(matrix)]
    coded = columns.encode(matrix, shifted_of(level, 3), with_count=True) if profile else None
    return min([*candidates, coded] if coded is not None else candidates, key=len)


def decode_added(data: bytes, profile: int, header: SceneHeader, most_rows: int) -> AnchorLevel:
    """The rows of an ADDED chunk."""
    channels = added_channels(header)
    if coding_of(data, profile):
        return level_from_added(header, columns.decode_counted(data, most_rows, channels, shifted_channels(header, 3)))
    return level_from_added(header, plain.decode_plain(data, channels, most_rows).astype(np.int64))


def _gaps(rows: Int64) -> Int64:
    return np.diff(rows, prepend=0)


def _rows(gaps: Int32, count: int) -> Int64:
    rows = np.cumsum(gaps, dtype=np.int64)
    if len(rows) and (gaps[0] < 0 or (gaps[1:] <= 0).any() or rows[-1] >= count):
        raise BitstreamError("corrupt_chunk", f"row numbers do not ascend below {count}")
    return rows
