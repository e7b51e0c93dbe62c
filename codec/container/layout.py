"""The layout of `.slod` files: records of packets, then an index and a footer. FORMAT.md section 15."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from streamlod.codec.packet.info import PacketInfo
from streamlod.codec.packet.packet import PacketKind
from streamlod.core.errors import BitstreamError

FILE_MAGIC = b"SLOD"
FILE_VERSION = 1
FILE_HEAD = FILE_MAGIC + bytes([FILE_VERSION, 0, 0, 0])
SIZE = struct.Struct("<I")  # before each packet
INDEX_MARK = 0xFFFFFFFF  # in place of a packet's size
FOOTER = struct.Struct("<QI4s")
FOOTER_MAGIC = b"SLIX"
_INDEX_HEAD = struct.Struct("<II")
_ENTRY = struct.Struct("<QIIIIQBBHI")
_KIND_AT, _FIELDS_AT = 6, 8  # in a packet
_FIELDS = struct.Struct("<IIIQH")  # keyframe, from_version, to_version, time_ns, level mask
_COARSE_LEVELS = 3  # levels that make the first picture


@dataclass(frozen=True, slots=True)
class Entry:
    """One packet of a file.

    Attributes:
        offset: where the packet begins, bytes from the file's start.
        size_bytes: its length.
        kind, keyframe, from_version, to_version, time_ns, level_mask: as in the packet header.
        coarse_bytes: length of the chunks of levels 0 to 2 together, without header and weights.
    """

    offset: int
    size_bytes: int
    kind: PacketKind
    keyframe: int
    from_version: int
    to_version: int
    time_ns: int
    level_mask: int
    coarse_bytes: int


def check_head(head: bytes, name: str) -> None:
    """Refuse a file called `name` whose first bytes, `head`, are not those of a file of this version.

    Raises:
        BitstreamError: `bad_file`, or `unsupported_version` for a `.slod` file of another version.
    """
    if head[:4] == FILE_MAGIC and len(head) == len(FILE_HEAD) and head[4] != FILE_VERSION:
        raise BitstreamError(
            "unsupported_version", f"{name} has file version {head[4]}; only version {FILE_VERSION} is known here"
        )
    if head != FILE_HEAD:
        raise BitstreamError("bad_file", f"{name} does not begin like a .slod file")


def entry_of(info: PacketInfo, offset: int) -> Entry:
    """The entry of a packet that begins at `offset`."""
    return Entry(
        offset,
        info.size_bytes,
        info.kind,
        info.keyframe,
        info.from_version,
        info.to_version,
        info.time_ns,
        info.level_mask,
        sum(info.level_bytes[:_COARSE_LEVELS]),
    )


def entries_of(infos: Iterable[PacketInfo], at: int) -> list[Entry]:
    """The entries of packets whose records lie one behind the other from byte `at` on."""
    entries = []
    for info in infos:
        entries.append(entry_of(info, at + SIZE.size))
        at += SIZE.size + info.size_bytes
    return entries


def is_packet_of(entry: Entry, packet: bytes) -> bool:
    """Whether the header of `packet`, of 44 bytes or more, says the same as its entry in the index."""
    fields = _FIELDS.pack(entry.keyframe, entry.from_version, entry.to_version, entry.time_ns, entry.level_mask)
    return packet[_KIND_AT] == entry.kind and packet.startswith(fields, _FIELDS_AT)


def record(packet: bytes) -> bytes:
    """A packet with its size before it."""
    return SIZE.pack(len(packet)) + packet


def file_end(entries: Sequence[Entry], at: int) -> bytes:
    """Index and footer of a file whose records end at byte `at`."""
    index = _INDEX_HEAD.pack(INDEX_MARK, len(entries)) + b"".join(map(_pack, entries))
    return index + FOOTER.pack(at, zlib.crc32(index), FOOTER_MAGIC)


def entries_in(index: bytes, checksum: int) -> tuple[Entry, ...] | None:
    """The entries of an index; None if it is damaged."""
    if len(index) < _INDEX_HEAD.size or zlib.crc32(index) != checksum:
        return None
    mark, count = _INDEX_HEAD.unpack_from(index)
    if mark != INDEX_MARK or len(index) != _INDEX_HEAD.size + _ENTRY.size * count:
        return None
    try:
        return tuple(_unpack(fields) for fields in _ENTRY.iter_unpack(index[_INDEX_HEAD.size :]))
    except ValueError:  # a kind of packet that there is not
        return None


def lie_in_order(entries: Sequence[Entry], end: int) -> bool:
    """Whether the packets lie one behind the other, each with its size before it, between the file's head and `end`."""
    at = len(FILE_HEAD)
    for entry in entries:
        if entry.offset < at + SIZE.size:
            return False
        at = entry.offset + entry.size_bytes
    return at <= end


def _pack(e: Entry) -> bytes:
    versions = (e.keyframe, e.from_version, e.to_version)
    return _ENTRY.pack(e.offset, e.size_bytes, *versions, e.time_ns, e.kind, 0, e.level_mask, e.coarse_bytes)


def _unpack(fields: tuple[int, ...]) -> Entry:
    offset, size, keyframe, start, end, time_ns, kind, _, mask, coarse = fields
    return Entry(offset, size, PacketKind(kind), keyframe, start, end, time_ns, mask, coarse)
