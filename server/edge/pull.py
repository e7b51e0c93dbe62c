"""The websocket to the origin: opened again whenever it breaks, acknowledged, its messages handed on in order."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import random
import time
from dataclasses import dataclass
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.typing import Subprotocol

from streamlod.codec.mp4.sound import is_piece
from streamlod.core.close_codes import REFUSALS, CloseCode
from streamlod.core.errors import SessionError
from streamlod.server.edge.ending import end
from streamlod.server.edge.origin import REFUSED_SECONDS, Origin, OriginStream
from streamlod.server.edge.origin_messages import OriginMessages
from streamlod.server.edge.supply import Supply
from streamlod.server.protocol.messages import LIVE, PROTOCOL_VERSION, SUBPROTOCOL, read_object
from streamlod.server.protocol.packets import Position
from streamlod.server.settings import Settings
from streamlod.server.stream.bus import Bus

_LOG = logging.getLogger(__name__)
_MIN_DELAY, _MAX_DELAY = 0.25, 1.0  # seconds between attempts to connect
_STEADY_SECONDS = 5.0  # of connection, after which the next break is a new one
_OPEN_SECONDS = 5.0
_CLOSE_SECONDS = 0.5
_PING_SECONDS, _PONG_SECONDS = 5.0, 10.0  # a dead machine answers no ping
_ACK_SECONDS = 0.5
_PRESENT_SECONDS = 0.1  # between two views


class OriginSource:
    """All streams of an origin, or some of them.

    Args:
        origin: the server.
        chosen: ids of streams; all without any.
        settings: of this server.
    """

    name = "the origin"

    def __init__(self, origin: Origin, chosen: tuple[str, ...], settings: Settings) -> None:
        self._origin, self._chosen, self._settings = origin, chosen, settings
        self._unknown = set[str]()  # ids of streams last told in unknown words
        self._known: dict[str, OriginStream] = {}  # as last told in known words

    async def streams(self) -> list[OriginStream]:
        """See `supply.StreamSource`."""
        try:
            told = await self._origin.streams()
        except OSError as error:
            kind = PermissionError if isinstance(error, PermissionError) else OSError
            raise kind(f"{error or 'no answer'} ({self._origin.url})") from error
        found = [each for each in told if not self._chosen or each.id in self._chosen]
        unknown = {each.id for each in found if not isinstance(each, OriginStream)}
        if new := unknown - self._unknown:
            _LOG.warning(
                "%s has streams of a kind that this version does not know: %s", self.name, ", ".join(sorted(new))
            )
        # one that is served stays, whatever its new state is called
        kept = [each if isinstance(each, OriginStream) else self._known.get(each.id) for each in found]
        self._unknown, self._known = unknown, {each.id: each for each in kept if each is not None}
        return list(self._known.values())

    async def edges(self) -> tuple[str, ...]:
        """See `supply.StreamSource`."""
        return await self._origin.edges()

    def supply(self, stream: OriginStream) -> Supply:
        """See `supply.StreamSource`."""
        settings = self._settings
        return _Websocket(self._origin, stream.id, settings.limits.packet_bytes, Bus(settings.retention.memory_bytes))


@dataclass(frozen=True, slots=True)
class _Websocket:
    """A stream's live websocket at the origin; see `supply.Supply`."""

    origin: Origin
    stream: str
    packet_bytes: int
    bus: Bus
    origin_name: str = OriginSource.name

    async def pull(self, taker: OriginMessages) -> None:
        """See `supply.Supply`."""
        url, failures = self.origin.live_url(self.stream), 0
        while True:
            begun, refused, fault = time.monotonic(), False, ""
            try:
                async with connect(
                    url,
                    subprotocols=[Subprotocol(SUBPROTOCOL)],
                    additional_headers=self.origin.headers,
                    compression=None,
                    max_size=self.packet_bytes,
                    open_timeout=_OPEN_SECONDS,
                    close_timeout=_CLOSE_SECONDS,
                    ping_interval=_PING_SECONDS,
                    ping_timeout=_PONG_SECONDS,
                ) as socket:
                    await _session(socket, taker)
            except ConnectionClosed as error:
                code, reason = (error.rcvd.code, error.rcvd.reason) if error.rcvd else (0, "")
                if code == CloseCode.DONE:
                    return
                refused, reason = code in REFUSALS, reason or "the connection broke"
            except SessionError as error:
                refused, reason = error.close_code == CloseCode.BAD_VERSION, error.detail
            except (OSError, WebSocketException) as error:
                reason, fault = "it does not answer", f"{error} at {self.origin.url}"  # viewers need no addresses
            taker.on_break(reason)
            failures = 0 if time.monotonic() - begun > _STEADY_SECONDS else failures + 1
            delay = REFUSED_SECONDS if refused else min(_MAX_DELAY, _MIN_DELAY * 2.0 ** min(failures, 10))
            delay *= random.uniform(0.5, 1.0)
            lost = f"the origin is lost ({fault or reason}); connecting again in {delay:.1f} s"
            _LOG.warning("stream %s: %s", self.stream, lost)
            await asyncio.sleep(delay)


async def _session(socket: ClientConnection, taker: OriginMessages) -> None:
    """Pull over one connection until it closes."""
    held, sent_ns = taker.held, time.time_ns()
    hello = {
        "type": "hello", "versions": [PROTOCOL_VERSION], "client": "streamlod-edge/1", "relay": True, "sound": True,
        "start": LIVE if held is None else held.to_json(),
    }  # fmt: skip
    await socket.send(json.dumps(hello))
    welcome = await _welcome(socket)
    presenting: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
    taker.on_welcome(welcome, sent_ns, presenting.put_nowait)
    every = welcome.get("ack_every")
    speaking = asyncio.create_task(_present(socket, presenting))
    try:
        await _listen(socket, taker, _Acknowledgements(every if type(every) is int else 1))
    finally:
        await end(speaking)


async def _present(socket: ClientConnection, messages: asyncio.Queue[dict[str, Any]]) -> None:
    """Tell the origin what a viewer presents, the newest, so often that no viewer can make it a flood."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            message = await messages.get()
            while not messages.empty():
                message = messages.get_nowait()
            await socket.send(json.dumps(message))
            await asyncio.sleep(_PRESENT_SECONDS)


async def _listen(socket: ClientConnection, taker: OriginMessages, acks: _Acknowledgements) -> None:
    """Hand on what the origin sends, until the connection closes."""
    while True:
        message = None
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_ACK_SECONDS):
                message = await socket.recv()
        if isinstance(message, bytes) and is_piece(message):
            taker.on_sound(message)
        elif isinstance(message, bytes):
            await taker.on_packet(message)
            acks.count(len(message))
        elif message is not None and (parsed := read_object(message)).get("type") == "event":
            taker.on_event(parsed)
        if (ack := acks.due(time.monotonic(), taker.held)) is not None:
            await socket.send(ack)


async def _welcome(socket: ClientConnection) -> dict[str, Any]:
    async with asyncio.timeout(_OPEN_SECONDS):
        text = await socket.recv()
    message = read_object(text) if isinstance(text, str) else {}
    if message.get("type") != "welcome":
        raise SessionError(CloseCode.BAD_MESSAGE, "the origin's first message is no welcome")
    if (version := message.get("version")) != PROTOCOL_VERSION:
        fault = f"the origin speaks version {version!r:.20} of the protocol, not {PROTOCOL_VERSION}"
        raise SessionError(CloseCode.BAD_VERSION, fault)
    return message


class _Acknowledgements:
    """When to tell the origin how much has arrived; see `ack` in docs/protocol.md.

    Args:
        every: packets after which one is due at once.
    """

    def __init__(self, every: int) -> None:
        self._every = every
        self._bytes = self._waiting = 0
        self._told_at = 0.0

    def count(self, size_bytes: int) -> None:
        """A packet has been taken."""
        self._bytes += size_bytes
        self._waiting += 1

    def due(self, now: float, held: Position | None) -> str | None:
        """The message, if it is time for one."""
        if not self._waiting or (self._waiting < self._every and now - self._told_at < _ACK_SECONDS):
            return None
        self._waiting, self._told_at = 0, now
        return json.dumps({"type": "ack", "bytes": self._bytes} | (held.to_json() if held else {}))
