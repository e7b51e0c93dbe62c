"""uvicorn's websocket protocol with a write path for frames that are made once and shared by all viewers.

uvicorn's own path copies every message that a socket does not take at once, so a keyframe would take memory for each
viewer. Here one `bytes` object is written to every transport, and the socket's buffer is bounded, so that lag is
noticed at once.
"""

from __future__ import annotations

import asyncio
import socket
from asyncio.transports import BaseTransport
from collections import Counter
from collections.abc import Callable
from typing import Any, ClassVar

from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame

from streamlod.core.close_codes import CloseCode
from streamlod.server.http.stall_watch import StallWatch
from streamlod.server.settings import Limits

_MAX_FRAGMENTS = 1024  # of a message; empty ones would cost memory without end
_TOO_LARGE = b"HTTP/1.1 431 Request Header Fields Too Large\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
CLOSE_SECONDS = 10.0  # that a peer has to answer a closing handshake
CONNECTION = "streamlod.connection"  # where an endpoint finds its connection in the ASGI scope


class ViewerProtocol(WebSocketsSansIOProtocol):
    """One websocket, and what its endpoint's `Connection` needs of it.

    Attributes:
        limits: of the server.
        turned_away: counts peers that break the websocket protocol, by close code, and those that stall.
        take: called with every text message before the endpoint; returns whether it has handled it.
        blocked: called when frames cannot be written, for a while or because the connection ended.
    """

    limits: ClassVar[Limits]
    turned_away: ClassVar[Counter[str]]
    take: Callable[[bytes], bool] | None = None
    blocked: Callable[[], None] | None = None
    _stalls: StallWatch | None = None
    _handshake: asyncio.TimerHandle | None = None

    def connection_made(self, transport: BaseTransport) -> None:
        super().connection_made(transport)
        self.close_timeout = CLOSE_SECONDS
        patience = 2 * self.limits.stuck_seconds  # a session that writes notices earlier, and reports it
        self._stalls = StallWatch(self.transport, patience, self.turned_away)
        # 0 reports every byte that the kernel does not take at once; TLS transports would then always count as full
        self.transport.set_write_buffer_limits(high=1, low=0)
        raw = transport.get_extra_info("socket")
        if raw is not None and raw.family in (socket.AF_INET, socket.AF_INET6):
            # the kernel doubles the value for its bookkeeping
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self.limits.viewer_bytes // 2)
            raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._handshake = self.loop.call_later(self.limits.request_seconds, self._end_handshake)

    def data_received(self, data: bytes) -> None:
        """Take bytes of the peer; the first call brings the whole upgrade request, replayed by the HTTP protocol.

        websockets has limits of its own on that request. Where one is exceeded, it keeps the error to itself and waits
        for the peer to leave, so the refusal is made here.
        """
        super().data_received(data)
        if not self.handshake_initiated and not self.transport.is_closing():
            self.turned_away["large"] += 1
            self.transport.write(_TOO_LARGE)
            self.transport.close()

    def _end_handshake(self) -> None:
        """Cut a connection whose upgrade was not answered in time."""
        self._handshake = None
        if not self.handshake_complete:
            self.turned_away["slow"] += 1
            self.transport.abort()

    def handle_text(self, event: Frame) -> None:
        if self.take is None or not event.fin or not self.take(bytes(event.data)):
            super().handle_text(event)

    def handle_cont(self, event: Frame) -> None:
        if len(self.frames) < _MAX_FRAGMENTS:
            super().handle_cont(event)
        elif not self.close_sent:
            self.conn.send_close(CloseCode.POLICY, f"more than {_MAX_FRAGMENTS} parts in a message")
            self.handle_parser_exception()

    def handle_ping(self) -> None:
        if self.writable.is_set():
            super().handle_ping()
        else:  # RFC 6455 section 5.5.3 asks for the latest one's answer only; none waits for a peer that takes none
            self.conn.data_to_send()

    def pause_writing(self) -> None:
        super().pause_writing()
        self._block()

    def resume_writing(self) -> None:
        if self._stalls is not None:
            self._stalls.emptied()
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._stalls is not None:
            self._stalls.end()
        if self._handshake is not None:
            self._handshake.cancel()
        self._block()
        super().connection_lost(exc)

    def handle_close(self, event: Frame) -> None:
        self._block()
        super().handle_close(event)

    def shutdown(self) -> None:
        self._block()
        super().shutdown()

    def _block(self) -> None:
        if self.blocked is not None:
            self.blocked()

    def handle_parser_exception(self) -> None:
        self._block()
        if self.conn.close_sent is not None:
            self.turned_away[str(int(self.conn.close_sent.code))] += 1
        super().handle_parser_exception()

    async def send(self, message: Any) -> None:
        """Send for the endpoint; ClientDisconnected also where a server that stops has refused the upgrade itself."""
        if not self.handshake_complete and self.transport.is_closing():
            raise ClientDisconnected
        await super().send(message)

    async def run_asgi(self) -> None:
        scope: dict[str, Any] = self.scope  # type: ignore[assignment]
        scope[CONNECTION] = Connection(self)
        await super().run_asgi()


def websocket_class(limits: Limits, turned_away: Counter[str]) -> type[ViewerProtocol]:
    """The protocol class for uvicorn's ``ws`` option; see the attributes of `ViewerProtocol`."""
    return type("ViewerProtocol", (ViewerProtocol,), {"limits": limits, "turned_away": turned_away})


class Connection:
    """A websocket as a viewer session uses it.

    Attributes:
        post: writes a whole websocket frame now; only while `is_clear`.
    """

    def __init__(self, protocol: ViewerProtocol) -> None:
        self._protocol = protocol
        # called directly, as it runs hundreds of times for each packet
        self.post: Callable[[bytes], None] = protocol.transport.write

    def listen(self, take: Callable[[bytes], bool] | None) -> None:
        """Give text messages to `take` as they arrive, without a queue; those it does not handle go to the endpoint."""
        self._protocol.take = take

    @property
    def unsent_bytes(self) -> int:
        """Bytes that the kernel has not taken yet."""
        return self._protocol.transport.get_write_buffer_size()

    def allow_messages_of(self, size_bytes: int) -> None:
        """Let the peer send longer messages than viewers need."""
        self._protocol.conn.max_message_size = size_bytes

    async def drain(self, stuck_seconds: float) -> None:
        """Wait until the write buffer has drained.

        Raises:
            TimeoutError: no byte left for `stuck_seconds`.
        """
        loop = asyncio.get_running_loop()
        left, since = self.unsent_bytes, loop.time()
        while not self._protocol.writable.is_set():
            try:
                async with asyncio.timeout(min(1.0, stuck_seconds)):
                    await self._protocol.writable.wait()
            except TimeoutError:
                now_left = self.unsent_bytes
                if now_left < left:
                    since = loop.time()
                left = now_left  # more than before, because of a keep-alive ping: no progress
                if loop.time() - since >= stuck_seconds:
                    raise

    async def write(self, frame: bytes, stuck_seconds: float) -> None:
        """Write a whole websocket frame once the write buffer has drained.

        Raises:
            TimeoutError: no byte left for `stuck_seconds`.
            ClientDisconnected: the peer is gone.
        """
        await self.drain(stuck_seconds)
        if self._protocol.disconnected or self._protocol.close_sent:
            raise ClientDisconnected
        self._protocol.transport.write(frame)

    @property
    def is_clear(self) -> bool:
        """Whether the write buffer has drained and the connection is open."""
        protocol = self._protocol
        return protocol.writable.is_set() and not protocol.close_sent and not protocol.transport.is_closing()

    def on_blocked(self, call: Callable[[], None] | None) -> None:
        """Have `call` called when the write buffer fills up or the connection ends."""
        self._protocol.blocked = call

    def abort(self) -> None:
        """Cut the connection without waiting for the peer."""
        self._protocol.transport.abort()
