"""uvicorn's HTTP protocol with limits on time and size, which uvicorn leaves to proxies.

A request's head and body are limited in size and must arrive within a time; so connections that send nothing, or one
byte at a time, or without end, cost little and not for long.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import ClassVar

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from streamlod.server.http.stall_watch import StallWatch
from streamlod.server.settings import Limits

_ANSWERS = {"slow": "408 Request Timeout", "large": "413 Content Too Large", "many": "503 Service Unavailable"}
_LARGE_HEAD = "431 Request Header Fields Too Large"
_MAX_FIELDS = 128  # of a head, and of what may follow a body in chunks
_MAX_WAITING_REQUESTS = 128  # pipelined requests that are not answered yet; each takes a hundred times its bytes


class _Refused(Exception):
    """Makes the parser stop; uvicorn answers 400 and closes, where there was no answer yet."""


class LimitedProtocol(HttpToolsProtocol):
    """One HTTP connection.

    Attributes:
        limits: of the server.
        turned_away: counts what was refused, by reason: slow, large, many, crowded, stalled.
    """

    limits: ClassVar[Limits]
    turned_away: ClassVar[Counter[str]]

    _timer: asyncio.TimerHandle | None = None
    _stalls: StallWatch | None = None
    _head_bytes = _body_bytes = _fields = _field_bytes = 0
    _in_body = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        seconds = self.limits.stuck_seconds
        self._stalls = StallWatch(transport, seconds, self.turned_away, self.limits.download_bytes_per_second * seconds)
        if len(self.connections) > 2 * self.limits.connections:  # up to here, a request is answered with 503
            self.turned_away["many"] += 1
            transport.abort()
        else:
            self._expect_request()

    def data_received(self, data: bytes) -> None:
        if not self._in_body:
            self._head_bytes += len(data)
        self._expect_request()
        if self._head_bytes <= self.limits.request_bytes or b"\r\n\r\n" in data:  # which a body may follow
            super().data_received(data)
        if self._head_bytes > self.limits.request_bytes:
            self._refuse("large", _LARGE_HEAD)

    def on_message_begin(self) -> None:
        if len(self.pipeline) >= _MAX_WAITING_REQUESTS:
            self.turned_away["crowded"] += 1
            raise _Refused
        self._fields = self._field_bytes = 0
        super().on_message_begin()

    def on_url(self, url: bytes) -> None:
        self._count_field(0, len(url))
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        self._count_field(1, len(name) + len(value))
        super().on_header(name, value)

    def _count_field(self, fields: int, size_bytes: int) -> None:
        """Count what the parser found in a head, which may have come whole in one piece of data."""
        self._fields += fields
        self._field_bytes += size_bytes
        if self._fields > _MAX_FIELDS or self._field_bytes > self.limits.request_bytes:
            self._refuse("large", _LARGE_HEAD)
            raise _Refused

    def send_400_response(self, msg: str) -> None:
        if not self.transport.is_closing():
            super().send_400_response(msg)

    def on_headers_complete(self) -> None:
        self._head_bytes, self._in_body = 0, True
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        self._body_bytes += len(body)
        if self._body_bytes > self.limits.request_bytes:
            self._refuse("large")
        else:
            super().on_body(body)

    def on_message_complete(self) -> None:
        self._body_bytes, self._in_body = 0, False
        self._forget_timer()
        super().on_message_complete()

    def resume_writing(self) -> None:
        if self._stalls is not None:
            self._stalls.emptied()
        super().resume_writing()

    def handle_websocket_upgrade(self) -> None:
        if len(self.connections) >= self.limits.connections:  # uvicorn checks this for other requests only
            self._refuse("many")
            return
        self._forget_timer()
        self._end_watch()  # the websocket's protocol has its own
        super().handle_websocket_upgrade()

    def connection_lost(self, exc: Exception | None) -> None:
        self._forget_timer()
        self._end_watch()
        super().connection_lost(exc)

    def _expect_request(self) -> None:
        if self._timer is None:
            self._timer = self.loop.call_later(self.limits.request_seconds, self._refuse, "slow")

    def _forget_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _end_watch(self) -> None:
        if self._stalls is not None:
            self._stalls.end()

    def _refuse(self, reason: str, answer: str | None = None) -> None:
        if self.transport.is_closing():
            return
        self.turned_away[reason] += 1
        head = f"HTTP/1.1 {answer or _ANSWERS[reason]}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
        self.transport.write(head.encode())
        self.transport.close()


def http_class(limits: Limits, turned_away: Counter[str]) -> type[LimitedProtocol]:
    """The protocol class for uvicorn's ``http`` option."""
    return type("LimitedProtocol", (LimitedProtocol,), {"limits": limits, "turned_away": turned_away})
