"""Packets to bytes and back. FORMAT.md section 2."""

from __future__ import annotations

import struct
import zlib

from streamlod.codec.packet.limits import DEFAULT_LIMITS, DecoderLimits
from streamlod.codec.packet.packet import Chunk, Packet, PacketKind
from streamlod.codec.packet.rules import check_directory, check_fields
from streamlod.core.errors import BitstreamError

MAGIC = b"SLPK"
FORMAT_VERSION = 1
MAX_PROFILE = 1
_FIXED = struct.Struct("<4sBBBBIIIQHHQ")
_CHECKSUM = struct.Struct("<I")
ENTRY = struct.Struct("<II")
HEADER_BYTES = _FIXED.size + _CHECKSUM.size
_LENGTH_MASK = (1 << 24) - 1


def build(packet: Packet) -> bytes:
    """The bytes of a packet.

    Raises:
        ValueError: a field out of its range, or a chunk longer than 2^24 - 1 bytes.
    """
    check_fields(
        packet.kind, packet.keyframe, packet.from_version, packet.to_version, packet.time_ns, packet.level_mask
    )
    longest = max((len(chunk.data) for chunk in packet.chunks), default=0)
    if longest > _LENGTH_MASK or packet.to_version >= 1 << 32 or not 0 <= packet.identifier < 1 << 64:
        raise ValueError(
            f"a chunk of {longest} bytes, version {packet.to_version} or identifier {packet.identifier} does not fit"
        )
    directory = b"".join(ENTRY.pack(c.level << 28 | c.kind << 24 | len(c.data), c.checksum) for c in packet.chunks)
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
        packet.identifier,
    )
    checksum = _CHECKSUM.pack(zlib.crc32(directory, zlib.crc32(fixed)))
    return b"".join([fixed, checksum, directory, *(chunk.data for chunk in packet.chunks)])


def parse(packet: bytes, limits: DecoderLimits = DEFAULT_LIMITS, *, verify: bool = True) -> Packet:
    """Take a packet apart; with `verify`, every chunk checksum is compared.

    Raises:
        BitstreamError: with the refusal codes and in the order of FORMAT.md section 13.
    """
    if len(packet) > limits.packet_bytes:
        raise BitstreamError("too_large", f"a packet of {len(packet)} bytes exceeds the limit {limits.packet_bytes}")
    if len(packet) < HEADER_BYTES:
        raise BitstreamError("truncated", f"{len(packet)} bytes are too few for a packet header of {HEADER_BYTES}")
    magic, version, profile, kind, reserved, *numbers = _FIXED.unpack_from(packet)
    keyframe, start, end, time_ns, mask, count, identifier = numbers
    if magic != MAGIC:
        raise BitstreamError("bad_magic", "the bytes do not begin a packet")
    if version != FORMAT_VERSION:
        raise BitstreamError(
            "unsupported_version", f"format version {version} is not known here, only {FORMAT_VERSION}"
        )
    if profile > MAX_PROFILE:
        raise BitstreamError("unsupported_profile", f"profile {profile} is not known here")
    chunks_at = HEADER_BYTES + ENTRY.size * count
    if len(packet) < chunks_at:
        raise BitstreamError("truncated", f"the packet ends inside its directory of {count} chunks")
    (checksum,) = _CHECKSUM.unpack_from(packet, _FIXED.size)
    if zlib.crc32(packet[HEADER_BYTES:chunks_at], zlib.crc32(packet[: _FIXED.size])) != checksum:
        raise BitstreamError("bad_checksum", "header and directory do not match their checksum")
    if reserved or kind > PacketKind.CHANGE:
        raise BitstreamError("bad_header", f"packet kind {kind} with reserved byte {reserved} is not known here")
    try:
        check_fields(PacketKind(kind), keyframe, start, end, time_ns, mask)
    except ValueError as error:
        raise BitstreamError("bad_header", str(error)) from error
    entries = list(ENTRY.iter_unpack(packet[HEADER_BYTES:chunks_at]))
    check_directory(PacketKind(kind), mask, [word >> 24 for word, _ in entries])
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
    return Packet(PacketKind(kind), profile, keyframe, start, end, time_ns, mask, identifier, tuple(chunks))
