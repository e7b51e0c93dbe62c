"""Packets as the server handles them: opaque bytes with a position in a stream, and the window of recent ones."""

from __future__ import annotations

import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

from websockets.frames import Frame, Opcode

from streamlod.codec.packet.info import PacketInfo, peek
from streamlod.codec.packet.levels import drop_levels
from streamlod.codec.packet.packet import PacketKind

_PACKET_OBJECTS_BYTES = 1000  # that a packet takes beside its data: small ones would fill the memory otherwise
PIECE_BYTES = 32_768  # of a refresh keyframe, sent at intervals


@dataclass(frozen=True, slots=True, order=True)
class Position:
    """A place in a stream: `epoch` counts encoder runs, `version` the states published in it."""

    epoch: int
    version: int

    def to_json(self) -> dict[str, int]:
        """JSON of the position, as in docs/protocol.md."""
        return {"epoch": self.epoch, "version": self.version}


Place = tuple[Position, bool]  # of a packet, and whether it is a keyframe, which comes after a residual of its position


@dataclass(frozen=True, eq=False)
class BinaryMessage:
    """One binary message to viewers, and the websocket frames that carry it, made once and shared by all of them."""

    data: bytes

    @cached_property
    def frame(self) -> bytes:
        """The message as one websocket frame."""
        return binary_frame(self.data)

    @cached_property
    def pieces(self) -> tuple[bytes, ...]:
        """The message as websocket frames of `PIECE_BYTES`."""
        return tuple(_fragments(memoryview(self.data)))


@dataclass(frozen=True, slots=True, eq=False)
class StreamPacket:
    """One published packet.

    Attributes:
        sequence: counts the packets of the stream in this process; a keyframe may share its position with the residual
            before it, never its sequence.
        position: epoch and version of the state after it.
        info: its header.
        data: the packet of codec/FORMAT.md.
        arrived: monotonic time at which it came, in seconds.
    """

    sequence: int
    position: Position
    info: PacketInfo
    data: bytes
    arrived: float
    _messages: dict[int, BinaryMessage] = field(default_factory=dict, repr=False)

    @property
    def is_key(self) -> bool:
        """Whether decoding can begin here."""
        return self.info.kind is PacketKind.KEY

    @property
    def place(self) -> Place:
        """Its place among the packets of the stream; in order, and no two have the same."""
        return self.position, self.is_key

    def follows(self, position: Position) -> bool:
        """Whether a decoder at `position` can take this packet."""
        return self.is_key or (self.position.epoch == position.epoch and self.info.from_version == position.version)

    def restricted(self, levels: int) -> bytes:
        """The packet with its coarsest `levels` levels."""
        return self.data if levels >= self.info.level_mask.bit_length() else drop_levels(self.data, levels - 1)

    def message(self, levels: int) -> BinaryMessage:
        """`restricted` as a message, made once and shared by all viewers."""
        held = min(levels, self.info.level_mask.bit_length())
        if held not in self._messages:
            self._messages[held] = BinaryMessage(self.restricted(held))
        return self._messages[held]

    def forget_messages(self) -> None:
        """Free the shared messages; they are made again when needed."""
        self._messages.clear()

    def without_messages(self) -> StreamPacket:
        """A copy to keep, without the shared messages."""
        return replace(self, _messages={})


def stream_packet(sequence: int, epoch: int, data: bytes) -> StreamPacket:
    """`data` as packet `sequence`; BitstreamError if its header is not valid."""
    info = peek(data)
    return StreamPacket(sequence, Position(epoch, info.to_version), info, data, time.monotonic())


def binary_frame(data: bytes) -> bytes:
    """One unmasked websocket frame with a whole binary message (RFC 6455 section 5.2)."""
    return Frame(Opcode.BINARY, data).serialize(mask=False)


def _fragments(data: memoryview) -> Iterator[bytes]:
    """`data` as one message in frames that carry at most `PIECE_BYTES` each (RFC 6455 section 5.4)."""
    for at in range(0, max(len(data), 1), PIECE_BYTES):
        opcode, end = Opcode.CONT if at else Opcode.BINARY, at + PIECE_BYTES
        yield Frame(opcode, data[at:end], fin=end >= len(data)).serialize(mask=False)


def text_frame(message: str) -> bytes:
    """One unmasked websocket frame with a whole text message."""
    return Frame(Opcode.TEXT, message.encode()).serialize(mask=False)


class PacketWindow:
    """The most recent packets of a stream, dropped from the front in whole groups of pictures.

    Args:
        limit_bytes: memory of the packets to keep; the newest group is kept whatever its size.
    """

    def __init__(self, limit_bytes: int) -> None:
        self._limit = limit_bytes
        self._packets: list[StreamPacket] = []
        self._ends: list[int] = []  # running total of memory up to and with each packet
        self._dropped_bytes = 0

    @property
    def packets(self) -> list[StreamPacket]:
        """All packets kept, oldest first."""
        return list(self._packets)

    @property
    def oldest(self) -> StreamPacket | None:
        """The first packet kept, always a keyframe."""
        return self._packets[0] if self._packets else None

    @property
    def newest(self) -> StreamPacket | None:
        """The last packet."""
        return self._packets[-1] if self._packets else None

    @property
    def size_bytes(self) -> int:
        """Memory of the packets kept."""
        return self._ends[-1] - self._dropped_bytes if self._ends else 0

    def append(self, packet: StreamPacket) -> None:
        """Add the newest packet.

        Raises:
            ValueError: it does not follow what is here.
        """
        newest = self.newest
        if newest is None:
            fits = packet.is_key
        else:
            fits = packet.sequence == newest.sequence + 1 and packet.follows(newest.position)
            fits = fits and packet.position >= newest.position
        if not fits:
            raise ValueError(f"packet {packet.position} does not apply to the newest state")
        total = self._ends[-1] if self._ends else self._dropped_bytes
        self._packets.append(packet)
        self._ends.append(total + len(packet.data) + _PACKET_OBJECTS_BYTES)
        while self.size_bytes > self._limit and self._drop_oldest_group():
            pass

    def after(self, sequence: int) -> StreamPacket | None:
        """The packet that comes next after packet `sequence`, if both are still in the window."""
        index = sequence + 1 - self._packets[0].sequence if self._packets else 0
        return self._packets[index] if 0 <= index < len(self._packets) else None

    def read(self, first: Position, last: Position) -> list[StreamPacket]:
        """Packets of positions `first` to `last`, both included."""
        place: Callable[[StreamPacket], Position] = lambda packet: packet.position  # noqa: E731
        begin = bisect_left(self._packets, first, key=place)
        return self._packets[begin : bisect_right(self._packets, last, key=place)]

    def groups(self) -> list[list[StreamPacket]]:
        """Groups of pictures, each from its keyframe on, oldest first."""
        starts = [i for i, packet in enumerate(self._packets) if packet.is_key]
        ends = [*starts[1:], len(self._packets)] if starts else []
        return [self._packets[a:b] for a, b in zip(starts, ends, strict=True)]

    def drop_newest_group(self) -> None:
        """Forget the newest group of pictures, the end of which will not come."""
        start = max((i for i, packet in enumerate(self._packets) if packet.is_key), default=0)
        del self._packets[start:], self._ends[start:]

    def _drop_oldest_group(self) -> bool:
        """Forget the oldest group, unless it is the only one; returns whether it was not."""
        end = next((i for i in range(1, len(self._packets)) if self._packets[i].is_key), None)
        if end is None:
            return False
        self._dropped_bytes = self._ends[end - 1]
        del self._packets[:end], self._ends[:end]
        return True
