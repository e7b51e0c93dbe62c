"""Packets sent directly from server to server, while JetStream stands still.

When the replicas of a stream have lost their leader, JetStream stores nothing for some seconds; the NATS servers that
are left deliver ordinary messages meanwhile. These arrive at most once: who misses one asks for it, or has it later.
Readers that cannot read from JetStream, though it stores packets again, ask as well.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from itertools import takewhile

from nats.aio.msg import Msg
from nats.errors import Error

from server.edge.jetstream.connection import NatsConnection
from server.edge.jetstream.messages import AFTER, MSG_ID, LiveSubjects, id_at, parse_id, pieces_of
from server.protocol.packets import Place, StreamPacket
from server.stream.bus import RECORD_SECONDS

_RECENT_SECONDS = 4.0  # what was stored so lately may not have reached every reader, and is sent as well
_MAX_BYTES = 4 << 20  # of packets sent at once; of more than that, only those from the newest keyframe on
_AGAIN_SECONDS = 0.5  # for which packets are not sent again, however many readers ask
_WANTED_SECONDS = 2.0  # for which packets are sent after a reader has asked
_LOOK_SECONDS = 0.05  # between two looks whether it can send


@dataclass(slots=True)
class _Noted:
    """A packet, the one before it, and the monotonic times since when it waits and at which it was stored."""

    packet: StreamPacket
    after: Place | None
    since: float
    stored_at: float = 0.0


class LiveSender:
    """Sends packets in order and once, while the oldest of them has waited too long for JetStream or a reader asks.

    Args:
        connection: to NATS.
        subjects: of the packets, and of what readers ask.
        incarnation: of the stream.
        may_send: whether this server publishes the stream.
    """

    def __init__(
        self, connection: NatsConnection, subjects: LiveSubjects, incarnation: str, may_send: asyncio.Event
    ) -> None:
        self._connection, self._subjects, self._incarnation = connection, subjects, incarnation
        self._may_send = may_send
        self._packets: deque[_Noted] = deque()  # those stored lately, and those that wait
        self._stored = 0  # how many of these are stored
        self._newest: Place | None = None
        self._sent = -1  # sequence of the newest packet that was sent
        self._allowed_at = self._again_at = self._wanted_until = 0.0
        self._changed = asyncio.Event()

    def append(self, packet: StreamPacket) -> None:
        """Take note of the newest packet, which waits for JetStream from now on."""
        self._packets.append(_Noted(packet, self._newest, time.monotonic()))
        self._newest = packet.place
        self._changed.set()

    def store(self) -> None:
        """JetStream has the oldest packet that waited; forget those that readers have from it by now."""
        now = time.monotonic()
        self._packets[self._stored].stored_at = now
        self._stored += 1
        while self._stored and now - self._packets[0].stored_at > _RECENT_SECONDS:
            self._packets.popleft()
            self._stored -= 1

    def clear(self) -> None:
        """Forget all packets: those that wait are left out, and who has some of them is to begin anew."""
        self._packets.clear()
        self._stored, self._newest = 0, None

    async def run(self) -> None:
        """Send what waits too long, until cancelled."""
        asking = await self._connection.client.subscribe(self._subjects.wanted, cb=self._answer)
        try:
            while True:
                await self._changed.wait()
                self._changed.clear()
                while (seconds := self._seconds_left()) is not None:
                    if not self._may_send.is_set():
                        await self._may_send.wait()
                        self._allowed_at = time.monotonic()  # before that, nothing was offered to JetStream
                    elif seconds > 0:
                        await asyncio.sleep(seconds)
                    elif not self._connection.client.is_connected:
                        await asyncio.sleep(_LOOK_SECONDS)
                    else:
                        await self._send()
                        break
        finally:
            with suppress(Error, OSError):
                await asking.unsubscribe()

    def _seconds_left(self) -> float | None:
        """Until packets are to be sent; None where none are, as things stand."""
        now = time.monotonic()
        if now < self._wanted_until:
            return 0.0
        if self._stored == len(self._packets):
            return None
        return max(self._packets[self._stored].since, self._allowed_at) + RECORD_SECONDS - now

    def _behind(self, sequence: int) -> list[_Noted]:
        found = list(takewhile(lambda noted: noted.packet.sequence > sequence, reversed(self._packets)))
        return found[::-1]

    def _limited(self, sequence: int) -> int:
        """Where to begin instead so that it is not too much: before the newest keyframe, if there is one."""
        behind = self._behind(sequence)
        if _size(behind) <= _MAX_BYTES:
            return sequence
        keys = [noted.packet.sequence for noted in behind if noted.packet.is_key]
        return keys[-1] - 1 if keys else sequence

    async def _send(self) -> None:
        """Send all behind the newest that was sent, whatever is appended, cleared or asked for meanwhile."""
        self._sent = self._limited(self._sent)
        while behind := self._behind(self._sent):
            noted = behind[0]
            self._sent, headers = noted.packet.sequence, {AFTER: id_at(self._incarnation, noted.after)}
            for found, data in pieces_of(self._incarnation, noted.packet, self._connection.piece_bytes):
                with suppress(Error, OSError):
                    message = headers | {MSG_ID: str(found)}
                    await self._connection.client.publish(self._subjects.packets, data, headers=message)

    async def _answer(self, request: Msg) -> None:
        """Send what comes behind the packet that a reader holds, and what follows."""
        held, now = parse_id(request.data.decode(errors="replace")), time.monotonic()
        seconds = self._seconds_left()
        if (seconds is None or seconds > 0) and self._stored:  # nothing is being sent: JetStream has these
            self._sent = max(self._sent, self._packets[self._stored - 1].packet.sequence)
        begin = self._begin(None if held is None else held.place)
        if begin < self._sent and now - self._again_at > _AGAIN_SECONDS:
            self._sent, self._again_at = begin, now
        self._wanted_until = now + _WANTED_SECONDS
        self._changed.set()

    def _begin(self, held: Place | None) -> int:
        """Sequence behind which a reader wants packets: of what it holds, or it begins with a keyframe."""
        packets = [noted.packet for noted in self._packets]
        if not packets:
            return self._sent
        if held is not None and held == self._packets[0].after:
            begin = packets[0].sequence - 1
        else:
            known = [packet.sequence for packet in packets if held is not None and packet.place <= held]
            keys = [packet.sequence - 1 for packet in packets if packet.is_key]
            begin = next(iter(known[-1:] or keys), self._sent)
        begin = self._limited(begin)
        return begin if _size(self._behind(begin)) <= _MAX_BYTES else self._sent


def _size(packets: list[_Noted]) -> int:
    return sum(len(noted.packet.data) for noted in packets)
