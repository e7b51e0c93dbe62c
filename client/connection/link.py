"""One connection to a stream: the websocket, what is said over it, and how it ends."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator
from contextlib import suppress
from dataclasses import dataclass

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from streamlod.client.connection.presenting import Presenter
from streamlod.client.events import Event
from streamlod.client.playback import Playback
from streamlod.codec.packet.limits import DEFAULT_LIMITS, DecoderLimits
from streamlod.core.errors import SessionError

SUBPROTOCOL = "streamlod.v1"
FOLLOW = '{"type": "follow", "on": true}'
_OPEN_SECONDS = 10.0
_CLOSE_SECONDS = 0.5  # the server's answer may be queued behind packets that nobody reads any more


@dataclass(frozen=True, slots=True)
class WatchOptions:
    """Wishes of a viewer, which the server is told when a stream is watched.

    Attributes:
        token: bearer token, where the server wants one.
        start: position (epoch, version) to replay from; the live edge by default.
        limits: what the decoder accepts; a stream that needs more ends with a SessionError.
        levels: how many levels, coarse ones first; all by default.
        follows: be told what a presenter shows, as a Notice `presenter` (`client.connection.presented`).
        nearest: watch at the nearest of the edges that the server names, where one answers.
        presents: what tells the server where this program looks, so that others can follow it.
    """

    token: str | None = None
    start: tuple[int, int] | None = None
    levels: int | None = None
    limits: DecoderLimits = DEFAULT_LIMITS
    nearest: bool = False
    follows: bool = False
    presents: Presenter | None = None


class StreamLink:
    """A viewer's connection, from `open` to `close`.

    Args:
        url: live websocket of the stream.
        options: what to ask the server for.

    Attributes:
        playback: the state of the stream.
        events: what the server tells, after `open`. They end with the error that ended the connection.
    """

    events: AsyncGenerator[Event, None]

    def __init__(self, url: str, options: WatchOptions) -> None:
        self.url, self.playback, self._options = url, Playback(options.limits), options
        self._socket: ClientConnection | None = None
        self._presenting: asyncio.Task[None] | None = None

    async def open(self, start: tuple[int, int] | None) -> None:
        """Connect and say hello; `start` is a position to replay from, the live edge by default.

        Raises:
            OSError, WebSocketException: there is no connection.
        """
        token = self._options.token
        socket = self._socket = await connect(
            self.url,
            subprotocols=[SUBPROTOCOL],  # type: ignore[list-item]
            additional_headers={"Authorization": f"Bearer {token}"} if token else None,
            compression=None,
            max_size=self._options.limits.packet_bytes,
            open_timeout=_OPEN_SECONDS,
            close_timeout=_CLOSE_SECONDS,
        )
        await socket.send(self.playback.hello(start, self._options.levels))
        if self._options.follows:
            await socket.send(FOLLOW)
        if self._options.presents is not None:
            self._presenting = asyncio.create_task(self._options.presents.run(socket))
        self.events = _session(socket, self.playback)

    async def close(self) -> None:
        """Leave; once more does no harm."""
        if self._presenting is not None:
            self._presenting.cancel()
        if self._socket is not None:
            await self._socket.close()


async def _session(socket: ClientConnection, playback: Playback) -> AsyncGenerator[Event, None]:
    """The events of one connection, which is closed with the error's code if the server breaks the protocol."""
    try:
        while True:
            try:
                async with asyncio.timeout(1.0):
                    message = await socket.recv()
            except TimeoutError:
                message = None
            events: list[Event] = []
            if isinstance(message, bytes):
                events = playback.receive_packet(message, time.monotonic())
            elif message is not None:
                events = playback.receive_text(message)
            for event in events:
                yield event
            acknowledgement = playback.acknowledgement(time.monotonic())
            if acknowledgement is not None:
                with suppress(ConnectionClosed):  # messages that arrived before the end can still be received
                    await socket.send(acknowledgement)
    except SessionError as error:
        await socket.close(error.close_code, error.detail[:120])
        raise
