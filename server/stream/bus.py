"""The retained packets of one stream: the newest in memory, older ones on disk.

For several servers, a bus across machines would take this place. It has to offer what `Bus` does and nothing more:
publish a packet, read a range of positions, and say what is retained. Viewers at the live edge do not read here; the
hub of their server writes to them.
"""

from __future__ import annotations

import asyncio
from concurrent.futures import Future

from codec.container import SlodReader
from server.protocol.packets import PacketWindow, Position, StreamPacket, stream_packet
from server.stream.store import Recording, Segment

_RECORD_SECONDS = 0.5  # that viewers wait for a disk that stands still


class Bus:
    """A bus inside one process.

    Args:
        memory_bytes: packets kept in memory.
        recording: where packets are also recorded, or None.
    """

    def __init__(self, memory_bytes: int, recording: Recording | None = None) -> None:
        self.window = PacketWindow(memory_bytes)
        self.recording = recording
        self._late: Future[None] | None = None  # the writing that viewers did not wait for any longer

    async def record(self, packet: StreamPacket) -> None:
        """Have the packet written, if there is a recording, and wait for that: nobody gets what could be lost.

        Where the disk stands still, viewers wait for it once, and then no more until it has caught up.
        """
        writing = None if self.recording is None else self.recording.append(packet)
        if writing is None or (self._late is not None and not self._late.done()):
            return
        done, _ = await asyncio.wait([asyncio.wrap_future(writing)], timeout=_RECORD_SECONDS)
        self._late = None if done else writing

    def publish(self, packet: StreamPacket, *, record: bool = True) -> None:
        """Add the newest packet, without waiting. With `record` False it exists only while it is in memory."""
        self.window.append(packet.without_frames())
        if self.recording is not None and record:
            self.recording.append(packet)

    async def read(self, first: Position, last: Position) -> list[StreamPacket]:
        """Packets of positions `first` to `last`, as far as they are retained, in order."""
        oldest = self.window.oldest
        if self.recording is None or (oldest is not None and first >= oldest.position):
            return self.window.read(first, last)
        segments = [s for s in self.recording.segments if s.first <= last and s.last >= first]
        return await asyncio.to_thread(_read_segments, segments, first, last)

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
