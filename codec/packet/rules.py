"""Which header fields, and which chunks, go together. FORMAT.md section 2."""

from __future__ import annotations

import itertools

from streamlod.codec.packet.packet import FIRST_EXTENSION, MAX_LEVELS, SCENE_CHUNKS, ChunkKind, PacketKind
from streamlod.core.errors import BitstreamError

_KEY_CHUNKS = frozenset({ChunkKind.HEADER, ChunkKind.WEIGHTS, ChunkKind.GEOMETRY, ChunkKind.BASE, ChunkKind.HASH})
_RESIDUAL_CHUNKS = frozenset({ChunkKind.CHANGE, ChunkKind.REMOVED, ChunkKind.ADDED, ChunkKind.HASH})


def check_fields(kind: PacketKind, keyframe: int, start: int, end: int, time_ns: int, mask: int) -> None:
    """Refuse header fields that contradict each other; ValueError says which."""
    if not 0 < mask < 1 << MAX_LEVELS:
        raise ValueError(f"level mask {mask:#x} names no level")
    if not 0 <= time_ns < 1 << 63:
        raise ValueError(f"presentation time {time_ns} ns is out of range")
    if kind is PacketKind.KEY and not keyframe == start == end:
        raise ValueError(f"a key packet cannot lead from version {start} to {end} under keyframe {keyframe}")
    if kind is not PacketKind.KEY and not keyframe <= start < end:
        raise ValueError(f"a packet cannot lead from version {start} to {end} under keyframe {keyframe}")


def check_directory(kind: PacketKind, mask: int, places: list[int]) -> None:
    """Refuse a directory whose entries, each `level << 4 | chunk kind`, are not those of such a packet.

    Raises:
        BitstreamError: `bad_directory` or `missing_chunk`.
    """
    if any(later <= earlier for earlier, later in itertools.pairwise(places)):
        raise BitstreamError("bad_directory", "directory entries do not ascend")
    known = _KEY_CHUNKS if kind is PacketKind.KEY else _RESIDUAL_CHUNKS
    for place in places:
        level, chunk = place >> 4, place & 15
        if chunk not in known and chunk < FIRST_EXTENSION:
            raise BitstreamError("bad_directory", f"chunk kind {chunk} has no place in a packet of kind {int(kind)}")
        if not mask >> level & 1 or (chunk in SCENE_CHUNKS and level):
            raise BitstreamError(
                "bad_directory", f"chunk kind {chunk} has no place in level {level} under the mask {mask:#x}"
            )
    present = frozenset(places)
    _check_pair(present, ChunkKind.HEADER, ChunkKind.WEIGHTS, 0)
    for level in range(MAX_LEVELS):
        _check_pair(present, ChunkKind.GEOMETRY, ChunkKind.BASE, level)


def _check_pair(present: frozenset[int], first: ChunkKind, second: ChunkKind, level: int) -> None:
    if (level << 4 | first in present) != (level << 4 | second in present):
        raise BitstreamError("missing_chunk", f"level {level} has only one of {first.name} and {second.name}")
