"""The websocket: connect, say hello, pass messages to `Playback`, and reconnect when the connection breaks."""

from __future__ import annotations

import asyncio
import logging
import random
import time
from collections.abc import AsyncGenerator
from contextlib import suppress
from dataclasses import dataclass
from urllib.parse import urlsplit

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus, InvalidURI, WebSocketException

from client.events import Disconnected, Event, NewScene
from client.playback import Playback
from codec.packet.limits import DEFAULT_LIMITS, DecoderLimits
from core.close_codes import REFUSALS, CloseCode
from core.errors import InputError, SessionError

_log = logging.getLogger(__name__)

SUBPROTOCOL = "streamlod.v1"
_MIN_DELAY = 0.5  # seconds between attempts
_MAX_DELAY = 15.0
_OPEN_SECONDS = 10.0
_CLOSE_SECONDS = 0.5  # the server's answer may be queued behind packets that nobody reads any more
_REFUSED = {401: "it needs a token", 403: "the token lacks the right", 404: "there is no such stream"}


@dataclass(frozen=True, slots=True)
class WatchOptions:
    """What to ask the server for when watching a stream.

    Attributes:
        token: bearer token, where the server wants one.
        start: position (epoch, version) to replay from; the live edge by default.
        limits: what the decoder accepts; a stream that needs more ends with a SessionError.
        levels: how many levels, coarse ones first; all by default.
    """

    token: str | None = None
    start: tuple[int, int] | None = None
    levels: int | None = None
    limits: DecoderLimits = DEFAULT_LIMITS


async def watch(url: str, options: WatchOptions = WatchOptions(), attempts: int = 8) -> AsyncGenerator[Event, None]:
    """The events of a stream, with reconnection; ends when the server says that the stream is over.

    After a break a live viewer joins at the live edge again; a replay continues where it stopped.

    Args:
        attempts: failures in a row after which to give up. The very first attempt must succeed.

    Raises:
        InputError: not a websocket address, or nobody answers there.
        SessionError: the server refuses us, or breaks the protocol twice in a row.
    """
    if urlsplit(url).scheme not in {"ws", "wss"}:
        raise InputError(url, "is not a websocket address; it looks like ws://HOST:PORT/v1/streams/main/live")
    failures, ever, start = 0, False, options.start
    while True:
        playback = Playback(options.limits)
        try:
            async with _open(url, options) as socket:
                await socket.send(playback.hello(start, options.levels))
                async for event in _session(socket, playback):
                    ever = True
                    failures = 0 if isinstance(event, NewScene) else failures
                    yield event
            return
        except (OSError, WebSocketException, SessionError) as error:
            if isinstance(error, ConnectionClosed) and error.rcvd is not None and error.rcvd.code == CloseCode.DONE:
                return
            reason = _reason(url, error, repeated=failures > 0 or not ever)
        failures += 1
        if not ever or failures > attempts:
            raise InputError(url, f"cannot be reached ({reason}); is the server running?")
        if playback.mode == "replay" and playback.position is not None:
            start = playback.position
        delay = back_off(failures - 1)
        _log.warning("%s: %s; connecting again in %.1f s", url, reason, delay)
        yield Disconnected(reason, delay)
        await asyncio.sleep(delay)


def _reason(url: str, error: Exception, repeated: bool) -> str:
    """Why a connection ended, if another attempt makes sense; otherwise raises."""
    match error:
        case InvalidStatus() if error.response.status_code < 500:
            status = error.response.status_code
            detail = _REFUSED.get(status, "it does not want this connection")
            raise InputError(url, f"the server answered {status}: {detail}") from error
        case InvalidURI():
            raise InputError(url, "is not a websocket address") from error
        case ConnectionClosed(rcvd=close) if close is not None:
            text = f"{close.reason or 'the connection broke'} [{close.code}]"
            if close.code in REFUSALS:
                raise SessionError(close.code, f"{url} closed the connection: {close.reason}") from error
            return text
        case SessionError() if repeated:
            raise error
        case OSError(strerror=str(text)):
            return text
    return str(error) or "no answer"


def back_off(failures: int) -> float:
    """Seconds to wait after `failures` earlier ones: 0.5 * 2^n, at most 15, times a random number from 0.5 to 1."""
    return min(_MAX_DELAY, _MIN_DELAY * 2.0 ** min(failures, 10)) * random.uniform(0.5, 1.0)


def _open(url: str, options: WatchOptions) -> connect:
    headers = {"Authorization": f"Bearer {options.token}"} if options.token else None
    return connect(
        url,
        subprotocols=[SUBPROTOCOL],  # type: ignore[list-item]
        additional_headers=headers,
        compression=None,
        max_size=options.limits.packet_bytes,
        open_timeout=_OPEN_SECONDS,
        close_timeout=_CLOSE_SECONDS,
    )


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
