"""`.slod` files put together from parts of others without copying them: codec/FORMAT.md section 15."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from codec.container import COARSE_LEVELS, SlodReader
from codec.packet.info import PacketInfo

FILE_HEAD = b"SLOD\x01\x00\x00\x00"
_SIZE = struct.Struct("<I")
_INDEX_HEAD = struct.Struct("<II")
_ENTRY = struct.Struct("<QIIIIQBBHI")
_FOOTER = struct.Struct("<QI4s")
_INDEX_MARK = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class FilePart:
    """`size` bytes of a file from `offset` on."""

    path: Path
    offset: int
    size: int


Piece = bytes | FilePart


def size_of(piece: Piece) -> int:
    """Length of a piece in bytes."""
    return len(piece) if isinstance(piece, bytes) else piece.size


def splice(groups: Sequence[Path | Sequence[tuple[PacketInfo, bytes]]]) -> tuple[Piece, ...]:
    """The pieces of one complete `.slod` file with the packets of `groups`: recorded files and packets in memory."""
    pieces: list[Piece] = [FILE_HEAD]
    entries: list[bytes] = []
    at = len(FILE_HEAD)
    for group in groups:
        if isinstance(group, Path):
            with SlodReader(group) as reader:
                shift = at - len(FILE_HEAD)
                for e in reader.entries:
                    place = (e.offset + shift, e.size_bytes, e.keyframe, e.from_version, e.to_version, e.time_ns)
                    entries.append(_ENTRY.pack(*place, e.kind, 0, e.level_mask, e.coarse_bytes))
                pieces.append(FilePart(group, len(FILE_HEAD), reader.records_end - len(FILE_HEAD)))
        else:
            offset = at
            for info, data in group:
                entries.append(_entry(info, offset + _SIZE.size))
                offset += _SIZE.size + len(data)
            pieces.append(b"".join(_SIZE.pack(len(data)) + data for _, data in group))
        at += size_of(pieces[-1])
    index = _INDEX_HEAD.pack(_INDEX_MARK, len(entries)) + b"".join(entries)
    pieces.append(index + _FOOTER.pack(at, zlib.crc32(index), b"SLIX"))
    return tuple(pieces)


def _entry(info: PacketInfo, offset: int) -> bytes:
    place = (offset, info.size_bytes, info.keyframe, info.from_version, info.to_version, info.time_ns)
    return _ENTRY.pack(*place, info.kind, 0, info.level_mask, sum(info.level_bytes[:COARSE_LEVELS]))
