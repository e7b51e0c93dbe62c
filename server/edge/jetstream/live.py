"""Packets sent directly from server to server, while JetStream stands still.

When the replicas of a stream have lost their leader, JetStream stores nothing for some seconds; the NATS servers that
are left deliver ordinary messages meanwhile. These arrive at most once: who misses one asks for it, or has it later.
Readers that cannot read from JetStream, though it stores packets again, ask as well.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress

from nats.aio.msg import Msg
from nats.errors import Error

from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.live_packets import LivePackets
from streamlod.server.edge.jetstream.messages import AFTER, MSG_ID, LiveSubjects, id_at, parse_id, pieces_of
from streamlod.server.protocol.packets import StreamPacket
from streamlod.server.stream.bus import RECORD_SECONDS

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

    Attributes:
        packets: those that it may have to send.
    """

    def __init__(
        self, connection: NatsConnection, subjects: LiveSubjects, incarnation: str, may_send: asyncio.Event
    ) -> None:
        self._connection, self._subjects, self._incarnation = connection, subjects, incarnation
        self._may_send = may_send
        self.packets = LivePackets()
        self._sent = -1  # sequence of the newest packet that was sent
        self._allowed_at = self._again_at = self._wanted_until = 0.0
        self._changed = asyncio.Event()

    def append(self, packet: StreamPacket) -> None:
        """Take note of the newest packet, which waits for JetStream from now on."""
        self.packets.append(packet)
        self._changed.set()

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
        since = self.packets.waiting_since
        return None if since is None else max(since, self._allowed_at) + RECORD_SECONDS - now

    async def _send(self) -> None:
        """Send all behind the newest that was sent, whatever is appended, cleared or asked for meanwhile."""
        self._sent = self.packets.limited(self._sent)
        while outgoing := self.packets.following(self._sent):
            packet, headers = outgoing.packet, {AFTER: id_at(self._incarnation, outgoing.after)}
            self._sent = packet.sequence
            for found, data in pieces_of(self._incarnation, packet, self._connection.piece_bytes):
                with suppress(Error, OSError):
                    message = headers | {MSG_ID: str(found)}
                    await self._connection.client.publish(self._subjects.packets, data, headers=message)

    async def _answer(self, request: Msg) -> None:
        """Send what comes behind the packet that a reader holds, and what follows."""
        held, now = parse_id(request.data.decode(errors="replace")), time.monotonic()
        seconds = self._seconds_left()
        if seconds is None or seconds > 0:  # nothing is being sent
            self._sent = max(self._sent, self.packets.newest_stored)
        begin = self.packets.begin(None if held is None else held.place)
        if begin is not None and begin < self._sent and now - self._again_at > _AGAIN_SECONDS:
            self._sent, self._again_at = begin, now
        self._wanted_until = now + _WANTED_SECONDS
        self._changed.set()
