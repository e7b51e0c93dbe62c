"""The retained packets of one stream: the newest in memory, older ones on disk.

What several servers share is an outbox here, into which a server that trains puts its packets, and a subclass that
reads the past from there (`server.edge.jetstream`). Viewers at the live edge do not read here; the hub of their server
writes to them.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Collection
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import dropwhile
from pathlib import Path
from typing import Protocol

from streamlod.codec.container import SlodReader
from streamlod.core.errors import BitstreamError, InputError
from streamlod.server.protocol.packets import PacketWindow, Position, StreamPacket, stream_packet
from streamlod.server.stream.recording.recording import Recording
from streamlod.server.stream.recording.segment import Segment

_LOG = logging.getLogger(__name__)
_RECORD_SECONDS = 0.5  # that viewers wait for a disk, or for other servers, when these stand still
GroupFile = Path | list[StreamPacket]  # a recorded group of pictures, or one in memory


@dataclass(frozen=True, slots=True)
class RetainedGroup:
    """One retained group of pictures.

    Attributes:
        first, last: positions of its keyframe and of its newest packet.
        packets, size_bytes: count and sum of sizes of its packets.
        begun_ns: Unix time at which its keyframe was recorded, where it is recorded.
        first_time_ns, last_time_ns: times at which its keyframe and its newest packet were filmed, as these packets
            say; None where they cannot be read.
    """

    first: Position
    last: Position
    packets: int
    size_bytes: int
    begun_ns: int | None
    first_time_ns: int | None = None
    last_time_ns: int | None = None


class Outbox(Protocol):
    """Where the packets that are made here leave for other servers.

    Attributes:
        waiting_bytes: of packets that have not been taken yet.
        lost_packets: that were left out.
    """

    waiting_bytes: int
    lost_packets: int

    def append(self, packet: StreamPacket) -> asyncio.Future[None] | None:
        """Queue the newest packet; what is done when it is stored there. None where it has to be left out."""


class Bus:
    """A bus inside one process.

    Args:
        memory_bytes: packets kept in memory.
        recording: where packets are also recorded, or None.
        keeps: whether new packets are recorded there; where not, it holds those of earlier times.

    Attributes:
        keeps: see above; as it is now.
        outbox: for other servers, or None.
    """

    outbox: Outbox | None = None

    def __init__(self, memory_bytes: int, recording: Recording | None = None, *, keeps: bool = True) -> None:
        self.window = PacketWindow(memory_bytes)
        self.recording = recording
        self.keeps = keeps and recording is not None
        self._newest: dict[str, asyncio.Future[None]] = {}  # of each writer, what viewers waited for last

    async def stop_keeping(self) -> None:
        """Record no more packets, as the same ones come again; unless a fault has kept some from the disk."""
        if self.recording is not None and self.keeps and self.recording.fault is None:
            self.keeps = False
            await self.recording.close()

    async def record(self, packet: StreamPacket) -> None:
        """Have the packet written, on disk and for other servers, and wait for that: nobody gets what could be lost.

        Where one of these stands still, viewers wait for it once, and then no more until it has caught up; they go on
        waiting for the other.
        """
        writings = self._write(packet)
        late = {writer for writer, newest in self._newest.items() if not newest.done()}
        prompt = {writer: writing for writer, writing in writings.items() if writer not in late}
        if prompt:
            self._newest |= prompt
            await asyncio.wait(prompt.values(), timeout=_RECORD_SECONDS)

    def _write(self, packet: StreamPacket) -> dict[str, asyncio.Future[None]]:
        recorded: Future[None] | None = None
        if self.recording is not None and self.keeps:
            recorded = self.recording.append(packet)
        sent = None if self.outbox is None else self.outbox.append(packet)
        writings = {"disk": None if recorded is None else asyncio.wrap_future(recorded), "outbox": sent}
        return {writer: writing for writer, writing in writings.items() if writing is not None}

    def publish(self, packet: StreamPacket) -> None:
        """Add the newest packet to those in memory."""
        self.window.append(packet.without_messages())

    def skip(self) -> None:
        """Packets are missing before the next one, a keyframe: the newest group of pictures gets no end."""
        self.window.drop_newest_group()

    async def read(self, first: Position, last: Position) -> list[StreamPacket]:
        """Packets of positions `first` to `last`, as far as they are retained, in order."""
        oldest = self.window.oldest
        recorded = self._segments
        if not recorded or (oldest is not None and first >= oldest.position):
            return self.window.read(first, last)
        segments = [s for s in recorded if s.first <= last and s.last >= first]
        return await asyncio.to_thread(_read_segments, segments, first, last)

    async def read_group(self, key: Position, last: Position) -> list[StreamPacket]:
        """Packets from the keyframe at `key` to `last`.

        A keyframe in mid-stream has the version of the change before it, which ends the group of pictures before.
        """
        return list(dropwhile(lambda packet: not packet.is_key, await self.read(key, last)))

    async def groups(self) -> list[RetainedGroup]:
        """All retained groups of pictures, oldest first."""
        found = {packets[0].position: _in_memory(packets) for packets in self.window.groups()}
        segments = list(self._segments)
        times = await asyncio.to_thread(lambda: {s.path: _filmed(s) for s in segments if s.first not in found})
        for s in segments:
            held = found.get(s.first) or RetainedGroup(s.first, s.last, s.packets, s.size_bytes, None, *times[s.path])
            found[s.first] = replace(held, begun_ns=s.begun_ns)
        return [found[first] for first in sorted(found)]

    async def files(self, firsts: Collection[Position] | None = None) -> dict[Position, GroupFile]:
        """The groups of pictures that begin at `firsts`, from disk where they are recorded.

        By default all; while something is recorded, what is not (early previews) does not count among these.

        Raises:
            InputError: they are too much for memory.
        """
        recorded: dict[Position, GroupFile] = {s.first: s.path for s in self._segments if s.packets}
        held: dict[Position, GroupFile] = {packets[0].position: packets for packets in self.window.groups()}
        if firsts is None:
            return recorded or held
        return {first: group for first, group in (held | recorded).items() if first in set(firsts)}

    @property
    def oldest(self) -> Position | None:
        """First position that can be read."""
        places = [self.window.oldest.position] if self.window.oldest else []
        return min([*places, *(segment.first for segment in self._segments[:1])], default=None)

    def key_after(self, position: Position) -> Position | None:
        """Position of the first retained keyframe after `position`."""
        return min((key for key in self._keys() if key > position), default=None)

    def key_before(self, position: Position) -> Position | None:
        """Position of the retained keyframe at or before `position`, or the oldest one there is."""
        keys = self._keys()
        return max((key for key in keys if key <= position), default=min(keys, default=None))

    def _keys(self) -> list[Position]:
        return [group[0].position for group in self.window.groups()] + [segment.first for segment in self._segments]

    @property
    def _segments(self) -> list[Segment]:
        return [] if self.recording is None else self.recording.segments


def _in_memory(packets: list[StreamPacket]) -> RetainedGroup:
    size_bytes = sum(len(packet.data) for packet in packets)
    filmed = packets[0].info.time_ns, packets[-1].info.time_ns
    return RetainedGroup(packets[0].position, packets[-1].position, len(packets), size_bytes, None, *filmed)


def _filmed(segment: Segment) -> tuple[int | None, int | None]:
    """Times of the first and last packet of a recorded group, which is listed without where it cannot be read."""
    try:
        return _filmed_in(segment.path, segment.first, segment.last)
    except (OSError, IndexError, InputError, BitstreamError):  # deleted meanwhile, or damaged
        return None, None


@lru_cache(maxsize=4096)
def _filmed_in(path: Path, first: Position, last: Position) -> tuple[int, int]:
    """Times in a file; kept, as a group of these positions never changes."""
    with SlodReader(path) as reader:
        return reader.entries[0].time_ns, reader.entries[-1].time_ns


def _read_segments(segments: list[Segment], first: Position, last: Position) -> list[StreamPacket]:
    packets = []
    for segment in segments:
        try:
            with SlodReader(segment.path) as reader:
                for number, entry in enumerate(reader.entries):
                    if first <= Position(segment.first.epoch, entry.to_version) <= last:
                        packets.append(stream_packet(-1, segment.first.epoch, reader.read(number)))
        except (InputError, BitstreamError) as error:  # deleted meanwhile, or damaged: the rest can still be had
            _LOG.warning("a recorded group is left out: %s", error)
    return packets
