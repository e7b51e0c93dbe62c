"""Zeros behind chunks that describe more numbers than their bytes may carry. FORMAT.md section 6."""

from __future__ import annotations

from streamlod.codec.chunks import geometry, plain
from streamlod.codec.chunks.level import CHANGE_COLUMNS
from streamlod.codec.chunks.matrices import added_channels, base_channels
from streamlod.codec.packet.limits import MAX_NUMBERS_A_BYTE
from streamlod.codec.packet.packet import PADDING, Chunk, ChunkKind, make_chunk
from streamlod.core.scene.anchors import SceneHeader


def padded(chunks: list[Chunk], header: SceneHeader, rows: int) -> list[Chunk]:
    """The chunks of one level, followed by a chunk of zeros where a decoder would refuse them without it.

    Args:
        rows: of the level, where it is a keyframe's.
    """
    numbers = max((_numbers(chunk, header, rows) for chunk in chunks), default=0)
    missing = -(-numbers // MAX_NUMBERS_A_BYTE) - sum(len(chunk.data) for chunk in chunks)
    return [*chunks, make_chunk(chunks[0].level, PADDING, bytes(missing))] if missing > 0 else chunks


def _numbers(chunk: Chunk, header: SceneHeader, rows: int) -> int:
    """Rows x columns of the table that a chunk describes; 0 for one whose rows the decoder holds already."""
    coded = chunk.kind not in (ChunkKind.HEADER, ChunkKind.WEIGHTS, ChunkKind.HASH) and chunk.data[0] != plain.CODING
    match chunk.kind:
        case ChunkKind.GEOMETRY:
            return rows * geometry.table_columns(geometry.depth_of(chunk.data) if coded else 0)
        case ChunkKind.BASE:
            return rows * base_channels(header)
        case ChunkKind.ADDED:
            return plain.row_count(chunk.data) * added_channels(header)
        case ChunkKind.CHANGE if not coded:
            return plain.row_count(chunk.data) * CHANGE_COLUMNS
        case ChunkKind.REMOVED:
            return plain.row_count(chunk.data)
    return 0
