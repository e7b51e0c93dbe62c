"""The live websocket: handshake, access rights, hello; then a `ViewerSession` takes over."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable

from fastapi import APIRouter
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.utils import ClientDisconnected

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError
from streamlod.server.api.access import address_of, admit, grant_of, registry_of, until_withdrawn
from streamlod.server.api.registry import Registry
from streamlod.server.auth.gate import Grant, Right
from streamlod.server.http.websocket import CONNECTION, Connection
from streamlod.server.protocol.messages import SUBPROTOCOL, Hello, parse_control, parse_hello
from streamlod.server.protocol.packets import BinaryMessage, text_frame
from streamlod.server.viewer.session import ViewerSession
from streamlod.server.viewer.thin_session import ThinSession

_LOG = logging.getLogger(__name__)
_MAX_REASON_BYTES = 123  # bytes, RFC 6455 section 5.5
_GONE = (WebSocketDisconnect, ClientDisconnected, ConnectionError)

router = APIRouter()


class _SocketTransport:
    """A session's transport: writes frames that are shared by viewers, bypassing the websocket library."""

    def __init__(self, websocket: WebSocket, stuck_seconds: float) -> None:
        self._stuck = stuck_seconds
        self.connection: Connection = websocket.scope[CONNECTION]
        self.post: Callable[[bytes], None] = self.connection.post
        self.on_blocked = self.connection.on_blocked

    async def binary(self, message: BinaryMessage, interval_seconds: float | None = None) -> None:
        if interval_seconds is None:
            await self.connection.write(message.frame, self._stuck)
            return
        for number, piece in enumerate(message.pieces):
            if number:
                await asyncio.sleep(interval_seconds)
            await self.connection.write(piece, self._stuck)

    async def text(self, message: str) -> None:
        await self.connection.write(text_frame(message), self._stuck)

    @property
    def is_clear(self) -> bool:
        return self.connection.is_clear


@router.websocket("/v1/streams/{stream_id}/live")
async def live(websocket: WebSocket, stream_id: str) -> None:
    """A viewer of docs/protocol.md."""
    registry = registry_of(websocket)
    offers = websocket.scope.get("subprotocols", [])
    await websocket.accept(SUBPROTOCOL if SUBPROTOCOL in offers else None)
    transport = _SocketTransport(websocket, registry.settings.limits.stuck_seconds)
    try:
        await _admit(websocket, registry, stream_id)
        hello = await _hello(websocket, registry.settings.limits.hello_seconds)
        await _watch(websocket, registry, stream_id, hello, transport)
    except SessionError as error:
        registry.turned_away[str(error.close_code)] += 1
        await _close(websocket, error.close_code, error.detail)
    except TimeoutError:
        limit = registry.settings.limits.stuck_seconds
        _LOG.warning("stream %s: a viewer at %s took no byte for %g s and is cut off", stream_id,
                     address_of(websocket), limit)  # fmt: skip
        if (stream := registry.streams.get(stream_id)) is not None:
            stream.counters.stuck += 1
        registry.turned_away[str(CloseCode.BUSY)] += 1
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.5):
                await _close(websocket, CloseCode.BUSY, f"no progress for {limit:g} s")
        transport.connection.abort()
    except _GONE:
        return
    except Exception:
        _LOG.exception("stream %s: a viewer's session broke", stream_id)
        await _close(websocket, CloseCode.FAULT, "internal server error")


async def _admit(websocket: WebSocket, registry: Registry, stream_id: str) -> None:
    if SUBPROTOCOL not in websocket.scope.get("subprotocols", []):
        raise SessionError(CloseCode.BAD_VERSION, f"offer the sub-protocol {SUBPROTOCOL}")
    await admit(websocket, Right.READ, stream_id)
    _find_room(registry, address_of(websocket))


def _find_room(registry: Registry, address: str) -> None:
    limits = registry.settings.limits
    if len(registry.sessions) >= limits.viewers:
        raise SessionError(CloseCode.BUSY, "the server is full; try again later")
    if list(registry.sessions.values()).count(address) >= limits.viewers_per_address:
        raise SessionError(CloseCode.BUSY, "too many viewers from this address")


async def _hello(websocket: WebSocket, seconds: float) -> Hello:
    try:
        async with asyncio.timeout(seconds):
            return parse_hello(await _text(websocket))
    except TimeoutError:
        raise SessionError(CloseCode.HELLO_TIMEOUT, f"no hello within {seconds:g} s") from None


async def _text(websocket: WebSocket) -> str:
    message = await websocket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1005))
    text = message.get("text")
    if not isinstance(text, str):
        raise SessionError(CloseCode.BAD_MESSAGE, "control messages are text")
    return text


async def _watch(
    websocket: WebSocket, registry: Registry, stream_id: str, hello: Hello, transport: _SocketTransport
) -> None:
    """Run the session and receive the viewer's messages, until either ends."""
    stream = registry.streams.get(stream_id)
    if stream is None:
        raise SessionError(CloseCode.NO_STREAM, "there is no such stream")
    limits, address = registry.settings.limits, address_of(websocket)
    _find_room(registry, address)  # again: many may have been admitted before the first of them said hello
    if hello.pictures:
        session: ViewerSession | ThinSession = ThinSession(
            stream, hello, transport, limits, registry.renderer, edges=registry.edges
        )
    else:
        session = ViewerSession(stream, hello, transport, limits, edges=registry.edges)

    def may_present(grant: Grant) -> None:
        session.companion.permit(grant.allows(Right.PRESENT, stream_id))

    def take(text: bytes) -> bool:
        try:
            session.on_control(parse_control(text.decode()))
        except (SessionError, UnicodeDecodeError):
            return False  # once more by `_listen`, which closes the connection
        return True

    may_present(grant_of(websocket))
    registry.sessions[session] = address
    registry.feed.tell("viewer.joined", stream_id, viewer=session.id, address=address, client=hello.client)
    transport.connection.listen(take)
    sending = asyncio.create_task(session.run())
    listening = asyncio.create_task(_listen(websocket, session))
    checking = asyncio.create_task(until_withdrawn(websocket, Right.READ, stream_id, may_present))
    tasks = (sending, listening, checking)
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        transport.connection.listen(None)
        transport.connection.on_blocked(None)
        registry.sessions.pop(session, None)
        told = session.describe()
        registry.feed.tell("viewer.left", stream_id, viewer=session.id, address=address, seconds=told["seconds"])
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        task.result()


async def _listen(websocket: WebSocket, session: ViewerSession | ThinSession) -> None:
    while True:
        session.on_control(parse_control(await _text(websocket)))


async def _close(websocket: WebSocket, code: int, reason: str) -> None:
    reason = reason.encode()[:_MAX_REASON_BYTES].decode(errors="ignore")
    with contextlib.suppress(RuntimeError, *_GONE):
        await websocket.close(code, reason)
