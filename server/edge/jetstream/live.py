"""Packets sent directly from server to server, while JetStream stands still.

When the replicas of a stream have lost their leader, JetStream stores nothing for some seconds; the NATS servers that
are left deliver ordinary messages meanwhile. These arrive at most once: who misses one asks for it, or has it later.
Readers that cannot read from JetStream, though it stores packets again, ask as well.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress

from nats.aio.msg import Msg
from nats.errors import Error

from server.edge.jetstream.connection import NatsConnection
from server.edge.jetstream.messages import MSG_ID, LiveSubjects, parse_id, pieces_of
from server.protocol.packets import StreamPacket
from server.stream.bus import RECORD_SECONDS

_RECENT_SECONDS = 4.0  # what was stored so lately may not have reached every reader, and is sent as well
_MAX_BYTES = 4 << 20  # of packets sent at once; of more than that, only those from the newest keyframe on
_AGAIN_SECONDS = 0.5  # for which packets are not sent again, however many readers ask
_WANTED_SECONDS = 2.0  # for which packets are sent after a reader has asked
_LOOK_SECONDS = 0.05  # between two looks whether it can send


class LiveSender:
    """Sends packets in order and once, while the oldest of them has waited too long for JetStream or a reader asks.

    Args:
        connection: to NATS.
        subjects: of the packets, and of what readers ask.
        incarnation: of the stream.
        may_send: whether this server publishes the stream.
        oldest: the packet that JetStream has to store next, or None.
    """

    def __init__(
        self,
        connection: NatsConnection,
        subjects: LiveSubjects,
        incarnation: str,
        may_send: asyncio.Event,
        oldest: Callable[[], StreamPacket | None],
    ) -> None:
        self._connection, self._subjects, self._incarnation = connection, subjects, incarnation
        self._may_send, self._oldest = may_send, oldest
        self._packets: deque[StreamPacket] = deque()  # those that wait, and those stored lately
        self._sent = -1  # sequence of the newest packet that was sent
        self._again_at = self._wanted_until = 0.0
        self._changed = asyncio.Event()

    def append(self, packet: StreamPacket) -> None:
        """Take note of the newest packet, and forget those that readers have from JetStream by now."""
        self._packets.append(packet)
        self._changed.set()
        oldest, limit = self._oldest() or packet, time.monotonic() - _RECENT_SECONDS
        while self._packets[0].sequence < oldest.sequence and self._packets[0].arrived < limit:
            self._packets.popleft()

    def clear(self) -> None:
        """Forget all packets."""
        self._packets.clear()

    async def run(self) -> None:
        """Send what waits too long, until cancelled."""
        asking = await self._connection.client.subscribe(self._subjects.wanted, cb=self._answer)
        try:
            while True:
                await self._changed.wait()
                self._changed.clear()
                while (seconds := self._seconds_left()) is not None:
                    if seconds > 0:
                        await asyncio.sleep(seconds)
                    elif not (self._may_send.is_set() and self._connection.client.is_connected):
                        await asyncio.sleep(_LOOK_SECONDS)
                    else:
                        await self._send()
                        break
        finally:
            with suppress(Error, OSError):
                await asking.unsubscribe()

    def _seconds_left(self) -> float | None:
        """Until packets are to be sent; None where none are, as things stand."""
        now, oldest = time.monotonic(), self._oldest()
        if now < self._wanted_until:
            return 0.0
        return None if oldest is None else oldest.arrived + RECORD_SECONDS - now

    async def _send(self) -> None:
        packets = [packet for packet in self._packets if packet.sequence > self._sent]
        keys = [number for number, packet in enumerate(packets) if packet.is_key]
        if keys and sum(len(packet.data) for packet in packets) > _MAX_BYTES:
            packets = packets[keys[-1] :]
        for packet in packets:
            self._sent = packet.sequence
            for found, data in pieces_of(self._incarnation, packet, self._connection.piece_bytes):
                with suppress(Error, OSError):
                    await self._connection.client.publish(self._subjects.packets, data, headers={MSG_ID: str(found)})

    async def _answer(self, request: Msg) -> None:
        """Send what comes behind the packet that a reader holds, and what follows."""
        held, now = parse_id(request.data.decode(errors="replace")), time.monotonic()
        seconds = self._seconds_left()
        is_sending = seconds is not None and seconds <= 0
        self._wanted_until = now + _WANTED_SECONDS
        if now - self._again_at > _AGAIN_SECONDS:
            self._again_at = now
            known = -1
            for packet in self._packets:
                if held is not None and (packet.position, packet.is_key) <= (held.position, held.is_key):
                    known = packet.sequence
            self._sent = min(self._sent, known) if is_sending else known
            self._changed.set()
