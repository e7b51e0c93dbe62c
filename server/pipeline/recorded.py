"""Packets of a recorded file that are streamed when it is played."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

from streamlod.codec.container import SlodReader
from streamlod.codec.container.layout import Entry
from streamlod.codec.packet.bytes import parse
from streamlod.codec.packet.info import peek
from streamlod.codec.packet.packet import PacketKind
from streamlod.core.errors import BitstreamError, InputError

_LOG = logging.getLogger(__name__)


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


def whole_packets(
    path: Path, streamed: Sequence[tuple[int, Entry]], damaged: set[int]
) -> Iterator[tuple[int, Entry, bytes]]:
    """The `streamed` packets of a file with their place among these, but from a damaged one up to the next keyframe.

    Args:
        damaged: places of packets that are known to be damaged; those found are logged and added.

    Raises:
        InputError: no keyframe is whole.
    """
    follows, shown = False, False  # whether what comes can be decoded after what came before; whether anything came
    with SlodReader(path) as reader:
        for place, (number, entry) in enumerate(streamed):
            follows = (follows or entry.kind is PacketKind.KEY) and place not in damaged
            if not follows:
                continue
            try:
                data = reader.read(number)
                parse(data)
            except BitstreamError as error:
                _LOG.warning("%s: left out from frame %d up to the next keyframe: %s", path, entry.to_version, error)
                damaged.add(place)
                follows = False
                continue
            shown = True
            yield place, entry, data
    if not shown:
        raise InputError(path, "is damaged: none of its keyframes is whole")
