"""The interface between the producer of packets and their consumers. A network could lie behind it.

`LocalBus` is the implementation for one machine: a window in memory in front of the recording on disk.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Protocol

from codec.container import SlodReader
from server.protocol.packets import PacketWindow, Position, StreamPacket, stream_packet
from server.stream.store import Recording, Segment


class Bus(Protocol):
    """Packets of one stream."""

    def publish(self, packet: StreamPacket, *, record: bool = True) -> None:
        """Add the newest packet, without waiting. With `record` False it exists only while it is in memory."""

    def subscribe(self, after: int) -> AsyncIterator[StreamPacket]:
        """Packets numbered above `after` as they come; one that left the window before it was taken is skipped."""

    async def read(self, first: Position, last: Position) -> list[StreamPacket]:
        """Packets of positions `first` to `last`, as far as they are retained, in order."""

    async def trim(self, before: Position) -> None:
        """Forget whole groups of pictures that end before `before`."""


class LocalBus:
    """A bus inside one process.

    Args:
        memory_bytes: packets kept in memory.
        recording: where everything goes as well, or None.
    """

    def __init__(self, memory_bytes: int, recording: Recording | None = None) -> None:
        self.window = PacketWindow(memory_bytes)
        self.recording = recording
        self._published = asyncio.Event()

    def publish(self, packet: StreamPacket, *, record: bool = True) -> None:
        self.window.append(packet.without_frames())
        if self.recording is not None and record:
            self.recording.append(packet)
        self._published.set()
        self._published = asyncio.Event()

    async def subscribe(self, after: int) -> AsyncIterator[StreamPacket]:
        while True:
            published = self._published
            packet = self.window.after(after)
            oldest = self.window.oldest
            if packet is None and oldest is not None and oldest.sequence > after:
                packet = oldest
            if packet is None:
                await published.wait()
                continue
            after = packet.sequence
            yield packet

    async def read(self, first: Position, last: Position) -> list[StreamPacket]:
        oldest = self.window.oldest
        if self.recording is None or (oldest is not None and first >= oldest.position):
            return self.window.read(first, last)
        segments = [s for s in self.recording.segments if s.first <= last and s.last >= first]
        return await asyncio.to_thread(_read_segments, segments, first, last)

    async def trim(self, before: Position) -> None:
        self.window.trim(before)
        if self.recording is not None:
            await self.recording.trim(before)

    @property
    def oldest(self) -> Position | None:
        """First position that can be read."""
        places = [self.window.oldest.position] if self.window.oldest else []
        if self.recording is not None:
            places += [segment.first for segment in self.recording.segments[:1]]
        return min(places, default=None)

    def key_after(self, position: Position) -> Position | None:
        """Position of the first retained keyframe after `position`."""
        return min((key for key in self._keys() if key > position), default=None)

    def key_before(self, position: Position) -> Position | None:
        """Position of the retained keyframe at or before `position`, or the oldest one there is."""
        keys = self._keys()
        return max((key for key in keys if key <= position), default=min(keys, default=None))

    def _keys(self) -> list[Position]:
        keys = [group[0].position for group in self.window.groups()]
        if self.recording is not None:
            keys += [segment.first for segment in self.recording.segments]
        return keys


def _read_segments(segments: list[Segment], first: Position, last: Position) -> list[StreamPacket]:
    packets = []
    for segment in segments:
        with SlodReader(segment.path) as reader:
            for number, entry in enumerate(reader.entries):
                if first <= Position(segment.first.epoch, entry.to_version) <= last:
                    packets.append(stream_packet(-1, segment.first.epoch, reader.read(number)))
    return packets
