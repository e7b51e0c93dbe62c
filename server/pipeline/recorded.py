"""Packets of a recorded file that are streamed when it is played."""

from __future__ import annotations

from pathlib import Path

from streamlod.codec.container import SlodReader
from streamlod.codec.container.layout import Entry
from streamlod.codec.packet.info import peek
from streamlod.codec.packet.packet import PacketKind
from streamlod.core.errors import InputError


def streamed_packets(path: Path) -> tuple[tuple[int, Entry], ...]:
    """Number and entry of each packet of the file that is a keyframe, or leads on from the streamed one before it.

    Raises:
        InputError: the file cannot be opened, or nothing of it can be streamed.
        BitstreamError: it is no `.slod` file, of another version, or damaged.
    """
    found: list[tuple[int, Entry]] = []
    with SlodReader(path) as reader:
        for number, entry in enumerate(reader.entries):
            if entry.kind is PacketKind.KEY:
                if not peek(reader.read(number)).has_header:
                    raise InputError(path, "its keyframes are cut into parts, which cannot be streamed")
            elif not found or entry.from_version != found[-1][1].to_version:
                continue
            found.append((number, entry))
        if not found:
            held = "no keyframe, which playing begins with" if reader.entries else "no packet"
            raise InputError(path, f"it holds {held}; record it again, or name another file")
    return tuple(found)
