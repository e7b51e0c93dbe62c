"""The packet: header, directory, chunks. Taking it apart, putting it together, dropping levels. FORMAT.md section 2."""

from __future__ import annotations

import itertools
import struct
import zlib
from dataclasses import dataclass, replace
from enum import IntEnum

from codec.limits import DEFAULT_LIMITS, Limits
from core.errors import BitstreamError

MAGIC = b"SLPK"
FORMAT_VERSION = 1
HIGHEST_PROFILE = 1
MAX_LEVELS = 16
_FIXED = struct.Struct("<4sBBBBIIIQHH")
_CHECKSUM = struct.Struct("<I")
_ENTRY = struct.Struct("<II")
HEADER_BYTES = _FIXED.size + _CHECKSUM.size
_LENGTH_MASK = (1 << 24) - 1


class PacketKind(IntEnum):
    """What a packet does to the state it meets."""

    KEY = 0
    PREDICTED = 1
    SKIP = 2
    CATCH_UP = 3


class ChunkKind(IntEnum):
    """What a chunk holds."""

    HEADER = 0
    WEIGHTS = 1
    GEOMETRY = 2
    BASE = 3
    CHANGE = 4
    REMOVED = 5
    ADDED = 6
    HASH = 7


FIRST_EXTENSION = 12  # chunk kinds from here on are skipped, not refused
_KEY_CHUNKS = frozenset({ChunkKind.HEADER, ChunkKind.WEIGHTS, ChunkKind.GEOMETRY, ChunkKind.BASE})
_RESIDUAL_CHUNKS = frozenset({ChunkKind.CHANGE, ChunkKind.REMOVED, ChunkKind.ADDED, ChunkKind.HASH})
_SCENE_CHUNKS = frozenset({ChunkKind.HEADER, ChunkKind.WEIGHTS})


@dataclass(frozen=True, slots=True)
class Chunk:
    """One directory entry and its bytes; `checksum` is the CRC-32 that the directory claims."""

    level: int
    kind: int
    data: bytes
    checksum: int

    @property
    def belongs_to_scene(self) -> bool:
        """Whether the chunk is filed under level 0 but concerns the whole scene."""
        return self.kind in _SCENE_CHUNKS


def make_chunk(level: int, kind: int, data: bytes) -> Chunk:
    """A chunk with its checksum."""
    return Chunk(level, kind, data, zlib.crc32(data))


@dataclass(frozen=True, slots=True)
class Packet:
    """A packet taken apart; chunks in directory order."""

    kind: PacketKind
    profile: int
    keyframe: int
    from_version: int
    to_version: int
    time_ns: int
    level_mask: int
    chunks: tuple[Chunk, ...]

    @property
    def levels(self) -> tuple[int, ...]:
        """Levels that the packet speaks for, coarse to fine."""
        return tuple(level for level in range(MAX_LEVELS) if self.level_mask >> level & 1)

    def chunk(self, level: int, kind: ChunkKind) -> bytes | None:
        """The bytes of chunk (level, kind), if the packet has it."""
        return next((c.data for c in self.chunks if c.level == level and c.kind == kind), None)


@dataclass(frozen=True, slots=True)
class PacketInfo:
    """What can be said of a packet without decoding its chunks.

    Attributes:
        kind, profile, keyframe, from_version, to_version, time_ns, level_mask: as in the packet header.
        level_bytes: bytes of each level's chunks, up to the finest level of the mask.
        chunk_bytes: bytes of each chunk kind, by lower-case name; extensions count as "extension".
        size_bytes: length of the packet.
        has_header: whether a key packet starts a new scene.
    """

    kind: PacketKind
    profile: int
    keyframe: int
    from_version: int
    to_version: int
    time_ns: int
    level_mask: int
    level_bytes: tuple[int, ...]
    chunk_bytes: dict[str, int]
    size_bytes: int
    has_header: bool


def peek(packet: bytes, limits: Limits = DEFAULT_LIMITS) -> PacketInfo:
    """Describe a packet from its header and directory alone.

    Raises:
        BitstreamError: header, directory or extents are not valid; chunk checksums are not looked at.
    """
    return describe(parse(packet, limits, verify=False))


def describe(packet: Packet) -> PacketInfo:
    """The facts of a packet already taken apart."""
    level_bytes = [0] * (packet.levels[-1] + 1)
    chunk_bytes: dict[str, int] = {}
    for chunk in packet.chunks:
        name = ChunkKind(chunk.kind).name.lower() if chunk.kind < FIRST_EXTENSION else "extension"
        chunk_bytes[name] = chunk_bytes.get(name, 0) + len(chunk.data)
        if not chunk.belongs_to_scene:
            level_bytes[chunk.level] += len(chunk.data)
    size = HEADER_BYTES + sum(_ENTRY.size + len(chunk.data) for chunk in packet.chunks)
    return PacketInfo(
        packet.kind,
        packet.profile,
        packet.keyframe,
        packet.from_version,
        packet.to_version,
        packet.time_ns,
        packet.level_mask,
        tuple(level_bytes),
        chunk_bytes,
        size,
        any(chunk.kind == ChunkKind.HEADER for chunk in packet.chunks),
    )


def build(packet: Packet) -> bytes:
    """The bytes of a packet.

    Raises:
        ValueError: a field out of its range, or a chunk longer than 2^24 - 1 bytes.
    """
    _refuse_impossible(packet)
    directory = b"".join(_ENTRY.pack(c.level << 28 | c.kind << 24 | len(c.data), c.checksum) for c in packet.chunks)
    fixed = _FIXED.pack(
        MAGIC,
        FORMAT_VERSION,
        packet.profile,
        packet.kind,
        0,
        packet.keyframe,
        packet.from_version,
        packet.to_version,
        packet.time_ns,
        packet.level_mask,
        len(packet.chunks),
    )
    checksum = _CHECKSUM.pack(zlib.crc32(directory, zlib.crc32(fixed)))
    return b"".join([fixed, checksum, directory, *(chunk.data for chunk in packet.chunks)])


def parse(packet: bytes, limits: Limits = DEFAULT_LIMITS, *, verify: bool = True) -> Packet:
    """Take a packet apart; with `verify`, every chunk checksum is compared.

    Raises:
        BitstreamError: with the refusal codes and in the order of FORMAT.md section 13.
    """
    if len(packet) > limits.packet_bytes:
        raise BitstreamError("too_large", f"a packet of {len(packet)} bytes exceeds the limit {limits.packet_bytes}")
    if len(packet) < HEADER_BYTES:
        raise BitstreamError("truncated", f"{len(packet)} bytes are too few for a packet header of {HEADER_BYTES}")
    magic, version, profile, kind, reserved, keyframe, start, end, time_ns, mask, count = _FIXED.unpack_from(packet)
    if magic != MAGIC:
        raise BitstreamError("bad_magic", "the bytes do not begin a packet")
    if version != FORMAT_VERSION:
        raise BitstreamError(
            "unsupported_version", f"format version {version} is not known here, only {FORMAT_VERSION}"
        )
    if profile > HIGHEST_PROFILE:
        raise BitstreamError("unsupported_profile", f"profile {profile} is not known here")
    chunks_at = HEADER_BYTES + _ENTRY.size * count
    if len(packet) < chunks_at:
        raise BitstreamError("truncated", f"the packet ends inside its directory of {count} chunks")
    (checksum,) = _CHECKSUM.unpack_from(packet, _FIXED.size)
    if zlib.crc32(packet[HEADER_BYTES:chunks_at], zlib.crc32(packet[: _FIXED.size])) != checksum:
        raise BitstreamError("bad_checksum", "header and directory do not match their checksum")
    if reserved or kind > PacketKind.CATCH_UP:
        raise BitstreamError("bad_header", f"packet kind {kind} with reserved byte {reserved} is not known here")
    try:
        _check_fields(PacketKind(kind), keyframe, start, end, time_ns, mask)
    except ValueError as error:
        raise BitstreamError("bad_header", str(error)) from error
    entries = list(_ENTRY.iter_unpack(packet[HEADER_BYTES:chunks_at]))
    _check_directory(PacketKind(kind), mask, [word >> 24 for word, _ in entries])
    total = chunks_at + sum(word & _LENGTH_MASK for word, _ in entries)
    if total != len(packet):
        code = "truncated" if total > len(packet) else "trailing_bytes"
        raise BitstreamError(code, f"the directory describes {total} bytes, the packet has {len(packet)}")
    chunks, at = [], chunks_at
    for word, claimed in entries:
        data = packet[at : at + (word & _LENGTH_MASK)]
        at += len(data)
        if verify and zlib.crc32(data) != claimed:
            raise BitstreamError("bad_checksum", f"chunk {word >> 24 & 15} of level {word >> 28} is damaged")
        chunks.append(Chunk(word >> 28, word >> 24 & 15, data, claimed))
    return Packet(PacketKind(kind), profile, keyframe, start, end, time_ns, mask, tuple(chunks))


def select_levels(packet: bytes, mask: int) -> bytes:
    """The packet with the levels of bit mask `mask` only; nothing is decoded.

    Raises:
        BitstreamError: the packet is not valid.
        ValueError: no level would remain.
    """
    return build(_select(parse(packet, verify=False), mask))


def drop_levels(packet: bytes, highest_level: int) -> bytes:
    """The packet without levels finer than `highest_level`; errors as in `select_levels`."""
    return select_levels(packet, (1 << highest_level + 1) - 1)


def split_levels(packet: bytes) -> tuple[bytes, ...]:
    """One packet a level, coarse first; of a key packet's parts the first one keeps header and weights.

    Raises:
        BitstreamError: the packet is not valid.
    """
    whole = parse(packet, verify=False)
    return tuple(build(_select(whole, 1 << level, first=level == whole.levels[0])) for level in whole.levels)


def _select(packet: Packet, mask: int, *, first: bool = True) -> Packet:
    kept = packet.level_mask & mask
    if kept == 0:
        raise ValueError(f"no level of the packet (mask {packet.level_mask:#x}) would remain with mask {mask:#x}")
    chunks = tuple(c for c in packet.chunks if (first if c.belongs_to_scene else kept >> c.level & 1))
    return replace(packet, level_mask=kept, chunks=chunks)


def _check_fields(kind: PacketKind, keyframe: int, start: int, end: int, time_ns: int, mask: int) -> None:
    if not 0 < mask < 1 << MAX_LEVELS:
        raise ValueError(f"level mask {mask:#x} names no level")
    if not 0 <= time_ns < 1 << 63:
        raise ValueError(f"presentation time {time_ns} ns is out of range")
    if kind is PacketKind.KEY and not keyframe == start == end:
        raise ValueError(f"a key packet cannot lead from version {start} to {end} under keyframe {keyframe}")
    if kind is not PacketKind.KEY and not keyframe <= start < end:
        raise ValueError(f"a packet cannot lead from version {start} to {end} under keyframe {keyframe}")
    if kind is PacketKind.CATCH_UP and start != keyframe:
        raise ValueError(f"a catch-up packet starts at its keyframe {keyframe}, not at {start}")


def _check_directory(kind: PacketKind, mask: int, places: list[int]) -> None:
    if any(later <= earlier for earlier, later in itertools.pairwise(places)):
        raise BitstreamError("bad_directory", "directory entries do not ascend")
    known = _KEY_CHUNKS if kind is PacketKind.KEY else _RESIDUAL_CHUNKS
    for place in places:
        level, chunk = place >> 4, place & 15
        if chunk not in known and chunk < FIRST_EXTENSION:
            raise BitstreamError("bad_directory", f"chunk kind {chunk} has no place in a packet of kind {int(kind)}")
        fits = level == 0 if chunk in _SCENE_CHUNKS else mask >> level & 1
        if not fits:
            raise BitstreamError(
                "bad_directory", f"chunk kind {chunk} lies in level {level}, outside the mask {mask:#x}"
            )
    present = frozenset(places)
    _check_pair(present, ChunkKind.HEADER, ChunkKind.WEIGHTS, 0)
    for level in range(MAX_LEVELS):
        _check_pair(present, ChunkKind.GEOMETRY, ChunkKind.BASE, level)


def _check_pair(present: frozenset[int], first: ChunkKind, second: ChunkKind, level: int) -> None:
    if (level << 4 | first in present) != (level << 4 | second in present):
        raise BitstreamError("missing_chunk", f"level {level} has only one of {first.name} and {second.name}")


def _refuse_impossible(packet: Packet) -> None:
    _check_fields(
        packet.kind, packet.keyframe, packet.from_version, packet.to_version, packet.time_ns, packet.level_mask
    )
    longest = max((len(chunk.data) for chunk in packet.chunks), default=0)
    if longest > _LENGTH_MASK or packet.to_version >= 1 << 32:
        raise ValueError(f"a chunk of {longest} bytes or version {packet.to_version} does not fit a packet")
