"""Segments of HLS out of retained packets, and the parts of a group of pictures that is not complete yet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby, pairwise
from pathlib import Path

from streamlod.codec.container import Piece, SlodReader
from streamlod.codec.container.layout import entries_of, record
from streamlod.codec.mp4.file import Group, groups_of
from streamlod.codec.mp4.playlist import PlaylistPart
from streamlod.codec.mp4.samples import TIMESCALE, microseconds, samples_of
from streamlod.codec.mp4.segment import fragment_head
from streamlod.server.protocol.packets import StreamPacket
from streamlod.server.stream.bus import GroupFile, RetainedGroup

_FRAME_SECONDS = 1 / 30  # of a group of one packet that nothing follows
_PART_NS = 10**9


def end_of(groups: Sequence[RetainedGroup], number: int) -> int | None:
    """When a group ends, in microseconds: when the next one of its encoder run begins; None where none does."""
    group, behind = groups[number], groups[number + 1] if number + 1 < len(groups) else None
    if behind is None or behind.first.epoch != group.first.epoch or behind.first_time_ns is None:
        return None
    return microseconds(behind.first_time_ns)


def seconds_of(groups: Sequence[RetainedGroup], number: int) -> float:
    """How long a group lasts."""
    group, end = groups[number], end_of(groups, number)
    begin = microseconds(group.first_time_ns or 0)
    if end is not None and end > begin:
        return (end - begin) / TIMESCALE
    known = (microseconds(group.last_time_ns or 0) - begin) / TIMESCALE
    return known * group.packets / (group.packets - 1) if group.packets > 1 and known > 0 else _FRAME_SECONDS


def segment_of(group: GroupFile, end: int | None) -> tuple[Piece, ...]:
    """The bytes of a segment, of a recorded group or of packets in memory.

    Raises:
        OSError: the file cannot be read.
        BitstreamError: it is damaged.
        ValueError: it is longer than a segment can be.
    """
    if isinstance(group, Path):
        with SlodReader(group) as reader:
            parts = groups_of(reader.entries, end=end)
            return Group(parts[0].time, parts[-1].end, reader.entries).pieces(group)
    entries = entries_of((packet.info for packet in group), 0)
    data = b"".join(record(packet.data) for packet in group)
    return fragment_head(entries[0].to_version + 1, samples_of(entries, end)), data


def finished_parts(
    packets: Sequence[StreamPacket], folder: str, is_run_start: bool, begun_ns: int | None
) -> tuple[PlaylistPart, ...]:
    """The parts of a group of pictures of which more may come: one for each second in which something was filmed.

    The newest of them is left out, as it may grow.

    Args:
        folder: of their addresses.
        is_run_start, begun_ns: of the group, see `PlaylistPart`.
    """
    if not packets:
        return ()
    begin = packets[0].info.time_ns
    seconds = [list(run) for _, run in groupby(packets, lambda packet: (packet.info.time_ns - begin) // _PART_NS)]
    parts: list[PlaylistPart] = []
    for here, behind in pairwise(seconds):
        first, last = here[0], here[-1]
        lasts = microseconds(behind[0].info.time_ns) - microseconds(first.info.time_ns)
        address = f"{folder}/parts/{first.position.version}-{last.position.version}.m4s"
        parts.append(PlaylistPart(address, max(lasts, 1) / TIMESCALE, begins_anew=not parts))
    if parts:
        parts[0] = replace(parts[0], is_run_start=is_run_start, begun_ns=begun_ns)
    return tuple(parts)
