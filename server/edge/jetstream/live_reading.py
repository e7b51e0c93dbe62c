"""Packets that another server sends directly, as `server.edge.jetstream.live` says."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator
from contextlib import aclosing, suppress

from nats.errors import Error

from streamlod.server.edge.ending import stop_if_cancelled
from streamlod.server.edge.jetstream.archive import id_of
from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.messages import AFTER, Assembler, LivePacket, LiveSubjects, id_at, parse_id
from streamlod.server.protocol.packets import Place

_MAX_MESSAGES = 4096  # that wait to be read
_RETRY_SECONDS = 0.25
_ASK_SECONDS = 0.6  # between two requests


class LiveReader:
    """Reads them for one stream.

    Args:
        connection: to NATS.
        subjects: of the packets, and to ask for them.
        incarnation: of the stream.
        packet_bytes: of a packet, at most.
    """

    def __init__(self, connection: NatsConnection, subjects: LiveSubjects, incarnation: str, packet_bytes: int) -> None:
        self._connection, self._subjects = connection, subjects
        self._incarnation, self._packet_bytes = incarnation, packet_bytes
        self._asked_at = -_ASK_SECONDS

    async def packets(self) -> AsyncGenerator[LivePacket, None]:
        """Packets as they come, for ever."""
        while True:
            stop_if_cancelled()
            with suppress(Error, OSError):
                async with aclosing(self._read()) as packets:
                    async for packet in packets:
                        yield packet
            await asyncio.sleep(_RETRY_SECONDS)

    async def ask(self, held: Place | None) -> None:
        """Have the packets behind `held` sent, since some were missed or JetStream gives none."""
        now = time.monotonic()
        if now - self._asked_at > _ASK_SECONDS:
            self._asked_at = now
            wanted = id_at(self._incarnation, held).encode()
            with suppress(Error, OSError):
                await self._connection.client.publish(self._subjects.wanted, wanted)

    async def _read(self) -> AsyncGenerator[LivePacket, None]:
        assembler = Assembler(self._packet_bytes)
        messages = await self._connection.client.subscribe(
            self._subjects.packets, pending_msgs_limit=_MAX_MESSAGES, pending_bytes_limit=2 * self._packet_bytes
        )
        try:
            while True:
                message = await messages.next_msg(timeout=None)
                found = id_of(message)
                if found is None or found.incarnation != self._incarnation:
                    continue
                data = assembler.push(found, message.data)
                if data is not None:
                    assembler = Assembler(self._packet_bytes)  # the packet may be sent again
                    before = parse_id((message.headers or {}).get(AFTER, ""))
                    yield LivePacket(found.place, None if before is None else before.place, data)
        finally:
            with suppress(Error, OSError):
                await messages.unsubscribe()
