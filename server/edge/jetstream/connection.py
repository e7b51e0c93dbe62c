"""The connection to NATS, made again for as long as it takes."""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress

from nats.aio.client import Client
from nats.js import JetStreamContext

from streamlod.server.edge.jetstream.messages import MAX_HEADER_BYTES, MAX_PIECE_BYTES
from streamlod.server.settings import JetStreamSettings

_LOG = logging.getLogger(__name__)
_RECONNECT_SECONDS = 0.25
_CONNECT_SECONDS = 2
REQUEST_SECONDS = 2.0
_PING_SECONDS = 5  # a dead machine answers no ping
_CLOSE_SECONDS = 1.0
_MAX_SAID = 100  # faults that the log has of one connection


class NatsConnection:
    """The connection to NATS, of which a server has one for everything.

    Attributes:
        fault: what NATS, or the attempt to reach it, said last; empty once it answers.
    """

    def __init__(self, settings: JetStreamSettings) -> None:
        self._settings = settings
        self._closing = False
        self._said: set[str] = set()
        self.fault = ""
        self.client = Client()

    @property
    def piece_bytes(self) -> int:
        """Largest number of bytes of a packet in one message."""
        return min(MAX_PIECE_BYTES, self.client.max_payload - MAX_HEADER_BYTES)

    @property
    def jetstream(self) -> JetStreamContext:
        """Its interface to JetStream; requests fail while there is no connection."""
        return self.client.jetstream(timeout=REQUEST_SECONDS)

    async def open(self) -> None:
        """Connect, however long it takes; from then on a lost connection is made again by itself."""

        async def say_lost() -> None:
            if not self._closing:
                _LOG.warning("the connection to NATS is lost; connecting again")

        async def say_back() -> None:
            self.fault = ""
            self._said.clear()
            _LOG.info("NATS answers again")

        async def say_fault(error: Exception) -> None:
            """Once for each fault: attempts fail several times a second, as does every message that is not allowed."""
            if not self.client.is_connected:  # an attempt to connect has failed
                self._hang_up()
            self.fault = fault = str(error) or type(error).__name__
            if fault not in self._said and len(self._said) < _MAX_SAID and not self._closing:
                self._said.add(fault)
                _LOG.warning("NATS: %s", fault)

        credentials = self._settings.credentials
        await self.client.connect(
            servers=list(self._settings.servers),
            name="streamlod",
            user_credentials=None if credentials is None else str(credentials),
            max_reconnect_attempts=-1,
            reconnect_time_wait=_RECONNECT_SECONDS,  # type: ignore[arg-type]  # it is passed to sleep
            connect_timeout=_CONNECT_SECONDS,
            ping_interval=_PING_SECONDS,
            disconnected_cb=say_lost,
            reconnected_cb=say_back,
            error_cb=say_fault,
        )
        self.fault = ""
        _LOG.info("connected to NATS")

    async def close(self) -> None:
        """Give it up."""
        self._closing = True
        try:
            with suppress(Exception):
                async with asyncio.timeout(_CLOSE_SECONDS):
                    await self.client.close()
        finally:
            self._hang_up()

    def _hang_up(self) -> None:
        """Close the socket, if there is one.

        nats-py leaves it open where an attempt to connect again fails after the socket was connected (a NATS that says
        nothing in time), and where closing is given up before it comes to that.
        """
        transport = self.client._transport
        if transport is not None:
            transport.close()  # type: ignore[no-untyped-call]
