"""Joins recorded files and packets into one `.slod` file without copying them. FORMAT.md section 15."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from streamlod.codec.container.layout import FILE_HEAD, Entry, entries_of, file_end, record
from streamlod.codec.container.reader import SlodReader
from streamlod.codec.packet.info import PacketInfo


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


def joined(groups: Sequence[Path | Sequence[tuple[PacketInfo, bytes]]]) -> tuple[Piece, ...]:
    """The pieces of one complete `.slod` file with the packets of `groups`: recorded files and packets in memory."""
    pieces: list[Piece] = [FILE_HEAD]
    entries: list[Entry] = []
    at = len(FILE_HEAD)
    for group in groups:
        if isinstance(group, Path):
            with SlodReader(group) as reader:
                shift = at - len(FILE_HEAD)
                entries += [replace(entry, offset=entry.offset + shift) for entry in reader.entries]
                pieces.append(FilePart(group, len(FILE_HEAD), reader.records_end - len(FILE_HEAD)))
        else:
            entries += entries_of((info for info, _ in group), at)
            pieces.append(b"".join(record(data) for _, data in group))
        at += size_of(pieces[-1])
    pieces.append(file_end(entries, at))
    return tuple(pieces)
