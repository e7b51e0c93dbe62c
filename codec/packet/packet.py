"""The parts of a packet: kinds, chunks, header fields. `codec.packet.bytes` reads and writes. FORMAT.md section 2."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from enum import IntEnum

MAX_LEVELS = 16


class PacketKind(IntEnum):
    """The effect of a packet on the state it meets: sets levels anew, or leads from one version to another."""

    KEY = 0
    CHANGE = 1


class ChunkKind(IntEnum):
    """The content of a chunk."""

    HEADER = 0
    WEIGHTS = 1
    GEOMETRY = 2
    BASE = 3
    CHANGE = 4
    REMOVED = 5
    ADDED = 6
    HASH = 7


FIRST_EXTENSION = 12  # chunk kinds from here on are skipped, not refused
METADATA = 12  # the extension with facts about the scene, in level 0 of a key packet that starts one
PADDING = 15  # the extension that this encoder fills with zeros where a level's chunks are shorter than they may be
SCENE_CHUNKS = frozenset({ChunkKind.HEADER, ChunkKind.WEIGHTS})


@dataclass(frozen=True, slots=True)
class Chunk:
    """One directory entry and its bytes; `checksum` is the CRC-32 that the directory claims."""

    level: int
    kind: int
    data: bytes
    checksum: int

    @property
    def belongs_to_scene(self) -> bool:
        """Whether the chunk is part of level 0 but concerns the whole scene."""
        return self.kind in SCENE_CHUNKS


def make_chunk(level: int, kind: int, data: bytes) -> Chunk:
    """A chunk with its checksum."""
    return Chunk(level, kind, data, zlib.crc32(data))


@dataclass(frozen=True, slots=True)
class PacketHeader:
    """The fields of FORMAT.md section 2 that say what a packet does."""

    kind: PacketKind
    profile: int
    keyframe: int
    from_version: int
    to_version: int
    time_ns: int
    level_mask: int
    identifier: int

    @property
    def levels(self) -> tuple[int, ...]:
        """Levels that the packet speaks for, coarse to fine."""
        return tuple(level for level in range(MAX_LEVELS) if self.level_mask >> level & 1)


@dataclass(frozen=True, slots=True)
class Packet(PacketHeader):
    """A packet taken apart: its header's fields, and its chunks in directory order."""

    chunks: tuple[Chunk, ...]

    def chunk(self, level: int, kind: int) -> bytes | None:
        """The bytes of chunk (level, kind), if the packet has it."""
        return next((c.data for c in self.chunks if c.level == level and c.kind == kind), None)

    def level_bytes(self, level: int) -> int:
        """Length of all chunks of `level`, which bounds the rows that they may describe."""
        return sum(len(c.data) for c in self.chunks if c.level == level)
