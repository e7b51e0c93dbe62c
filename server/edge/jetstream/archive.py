"""The past of a stream, read from JetStream: which keyframes are there, and what follows each."""

from __future__ import annotations

import asyncio
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterator
from contextlib import aclosing
from dataclasses import dataclass, field
from datetime import datetime

from nats.aio.msg import Msg
from nats.errors import Error

from streamlod.server.edge.ending import end
from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.messages import MSG_ID, Assembler, MessageId, Names, parse_id
from streamlod.server.edge.jetstream.reading import Selection, follow, read
from streamlod.server.protocol.packets import Position, StreamPacket, stream_packet
from streamlod.server.stream.bus import RetainedGroup

_TRIM_SECONDS = 2.0  # between two looks at what JetStream has discarded
_SIZE = "Nats-Msg-Size"


@dataclass(slots=True)
class _Group:
    """A group of pictures in JetStream: its keyframe, and as much of its contents as has been looked up.

    Attributes:
        first, sequence, begun_ns: of the keyframe: position, sequence number of its first message, Unix time.
        positions, sequences: of each packet looked up so far.
        size_bytes: of these packets.
        next_sequence: where to look up further.
    """

    first: Position
    sequence: int
    begun_ns: int
    positions: list[Position] = field(default_factory=list)
    sequences: list[int] = field(default_factory=list)
    size_bytes: int = 0
    next_sequence: int = 0
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)


class Archive:
    """The packets of one stream that JetStream holds.

    Args:
        connection: to NATS.
        names: of streams and subjects.
        stream, incarnation: whose packets.
        packet_bytes: of a packet, at most.
    """

    def __init__(
        self, connection: NatsConnection, names: Names, stream: str, incarnation: str, packet_bytes: int
    ) -> None:
        self._connection, self._packet_bytes = connection, packet_bytes
        self.stream = names.packets(stream)
        self._keyframes = names.subject(stream, incarnation, "k")
        self.sound = names.subject(stream, incarnation, "s")
        self.subject = names.subject(stream, incarnation, "*")
        self._groups: list[_Group] = []
        self._created: datetime | None = None  # the JetStream stream; another time means that what is known is lost

    @property
    def keys(self) -> list[Position]:
        """Positions of the keyframes, in order."""
        return [group.first for group in self._groups]

    @property
    def newest_key(self) -> int | None:
        """Sequence number of the newest keyframe's first message."""
        return self._groups[-1].sequence if self._groups else None

    async def load(self) -> None:
        """Look up the keyframes that are there.

        Raises:
            OSError: NATS does not answer.
        """
        try:
            info = await self._connection.jetstream.stream_info(self.stream)
        except Error as error:
            raise OSError(f"JetStream does not answer ({error})") from error
        self._groups, self._created = [], info.created
        selection = Selection(self.stream, self._keyframes, headers_only=True)
        async with aclosing(read(self._connection, selection, 1, None)) as messages:
            async for message in messages:
                self._add(message)

    async def run(self) -> None:
        """Take note of new keyframes, and of what JetStream has discarded, until cancelled.

        Raises:
            ValueError: JetStream has lost all of it, and counts from one again; sequence numbers mean other messages.
        """
        following = asyncio.create_task(self._follow())
        try:
            await self._trim()
        finally:
            await end(following)

    async def read(self, first: Position, last: Position) -> list[StreamPacket]:
        """Packets of positions `first` to `last`, in order.

        Raises:
            OSError: NATS does not answer.
        """
        found: list[StreamPacket] = []
        for group, following in self._spans(first):  # the group before ends with a packet of this position, perhaps
            if group.first > last:
                break
            await self._look_up(group, following)
            begin, end = bisect_left(group.positions, first), bisect_right(group.positions, last)
            if begin < end:
                stop = group.sequences[end] if end < len(group.sequences) else group.next_sequence
                packets = await self._packets(group.sequences[begin], stop)
                found += [packet for packet in packets if first <= packet.position <= last]  # none after a loss
        return found

    async def groups(self, firsts: Collection[Position] | None = None) -> list[RetainedGroup]:
        """The groups of pictures that begin at `firsts`, by default all.

        Raises:
            OSError: NATS does not answer.
        """
        found = []
        wanted = None if firsts is None else set(firsts)
        for group, following in self._spans():
            if wanted is not None and group.first not in wanted:
                continue
            await self._look_up(group, following)
            if group.positions[:1] == [group.first]:
                size = len(group.positions), group.size_bytes
                found.append(RetainedGroup(group.first, group.positions[-1], *size, group.begun_ns))
        return found

    async def group(self, first: Position) -> list[StreamPacket]:
        """The packets of the group of pictures that begins at `first`; none where there is no such group.

        Raises:
            OSError: NATS does not answer.
        """
        for group, following in self._spans(first):
            if group.first == first:
                await self._look_up(group, following)
                positions = list(group.positions)
                packets = await self._packets(group.sequence, group.next_sequence)
                return packets if [packet.position for packet in packets] == positions else []  # lost meanwhile
            if group.first > first:
                break
        return []

    def _spans(self, first: Position | None = None) -> Iterator[tuple[_Group, _Group | None]]:
        """Each group and the one that ends it, by default all, or from the last that begins before `first`."""
        groups = self._groups
        begin = 0 if first is None else max(0, bisect_left(groups, first, key=lambda group: group.first) - 1)
        for at in range(begin, len(groups)):
            yield groups[at], groups[at + 1] if at + 1 < len(groups) else None

    def _add(self, message: Msg) -> None:
        found, at = id_of(message), message.metadata
        if found is None or found.piece != 0 or at.sequence.stream <= (self.newest_key or 0):
            return
        if self._groups and self._groups[-1].first >= found.position:  # stored twice
            return
        begun_ns = int(at.timestamp.timestamp() * 1e9)
        self._groups.append(_Group(found.position, at.sequence.stream, begun_ns, next_sequence=at.sequence.stream))

    async def _look_up(self, group: _Group, following: _Group | None) -> None:
        """Complete the contents of a group, up to what is there now."""
        end = None if following is None else following.sequence
        async with group.lock:
            if end is not None and group.next_sequence >= end:
                return
            selection = Selection(self.stream, self.subject, headers_only=True)
            begun, size = 0, 0
            expected: MessageId | None = None
            async with aclosing(read(self._connection, selection, group.next_sequence, end)) as messages:
                async for message in messages:
                    found, sequence = id_of(message), message.metadata.sequence.stream
                    if found is None or found == expected:
                        continue
                    if found.is_key and found.position != group.first:  # the next group, or what came after a loss
                        break
                    if found.piece == 0:
                        begun, size = sequence, 0
                    size += int((message.headers or {}).get(_SIZE, 0))
                    expected = found
                    if found.is_last:
                        group.positions.append(found.position)
                        group.sequences.append(begun)
                        group.size_bytes += size
                        group.next_sequence = sequence + 1
            if end is not None:
                group.next_sequence = end

    async def _packets(self, first: int, end: int) -> list[StreamPacket]:
        assembler, packets = Assembler(self._packet_bytes), list[StreamPacket]()
        selection = Selection(self.stream, self.subject)
        async with aclosing(read(self._connection, selection, first, end)) as messages:
            async for message in messages:
                if (found := id_of(message)) and (data := assembler.push(found, message.data)) is not None:
                    packets.append(stream_packet(-1, found.position.epoch, data))
        return packets

    async def _follow(self) -> None:
        selection = Selection(self.stream, self._keyframes, headers_only=True)
        async for message in follow(self._connection, selection, (self.newest_key or 0) + 1):
            self._add(message)

    async def _trim(self) -> None:
        lost = False
        while True:
            await asyncio.sleep(_TRIM_SECONDS)
            try:
                info = await self._connection.jetstream.stream_info(self.stream)
            except (Error, OSError):
                continue
            behind = info.state.last_seq < (self.newest_key or 0)
            if info.created != self._created or (lost and behind):  # twice: a new leader may be a moment behind
                raise ValueError("its stream in JetStream was made anew")
            lost = behind
            self._groups = [group for group in self._groups if group.sequence >= info.state.first_seq]


def id_of(message: Msg) -> MessageId | None:
    """The packet in a message, or None where it is none of ours."""
    return parse_id((message.headers or {}).get(MSG_ID, ""))
