"""Facts about a packet that need no decoding."""

from __future__ import annotations

from dataclasses import dataclass

from streamlod.codec.packet.bytes import ENTRY, HEADER_BYTES, parse
from streamlod.codec.packet.limits import DEFAULT_LIMITS, DecoderLimits
from streamlod.codec.packet.packet import FIRST_EXTENSION, METADATA, ChunkKind, Packet, PacketHeader


@dataclass(frozen=True, slots=True)
class PacketInfo(PacketHeader):
    """Facts about a packet, from its header and directory.

    Attributes:
        level_bytes: bytes of each level's chunks without header and weights, up to the finest level of the mask.
        chunk_bytes: bytes of each chunk kind, by lower-case name; extensions but metadata count as "extension".
        size_bytes: length of the packet.
        has_header: whether a key packet starts a new scene.
    """

    level_bytes: tuple[int, ...]
    chunk_bytes: dict[str, int]
    size_bytes: int
    has_header: bool


def peek(packet: bytes, limits: DecoderLimits = DEFAULT_LIMITS) -> PacketInfo:
    """Describe a packet from its header and directory alone.

    Raises:
        BitstreamError: header, directory or extents are not valid; chunk checksums are not looked at.
    """
    return describe(parse(packet, limits, verify=False))


def _name(kind: int) -> str:
    if kind < FIRST_EXTENSION:
        return ChunkKind(kind).name.lower()
    return "metadata" if kind == METADATA else "extension"


def describe(packet: Packet) -> PacketInfo:
    """The facts of a packet already taken apart."""
    level_bytes = [0] * (packet.levels[-1] + 1)
    chunk_bytes: dict[str, int] = {}
    for chunk in packet.chunks:
        name = _name(chunk.kind)
        chunk_bytes[name] = chunk_bytes.get(name, 0) + len(chunk.data)
        if not chunk.belongs_to_scene:
            level_bytes[chunk.level] += len(chunk.data)
    size = HEADER_BYTES + sum(ENTRY.size + len(chunk.data) for chunk in packet.chunks)
    return PacketInfo(
        packet.kind,
        packet.profile,
        packet.keyframe,
        packet.from_version,
        packet.to_version,
        packet.time_ns,
        packet.level_mask,
        packet.identifier,
        tuple(level_bytes),
        chunk_bytes,
        size,
        any(chunk.kind == ChunkKind.HEADER for chunk in packet.chunks),
    )
