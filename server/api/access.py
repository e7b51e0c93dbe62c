"""Access rights and errors of HTTP requests."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Annotated, Any, NoReturn
from urllib.parse import urlsplit

from fastapi import Depends, Request
from starlette.requests import HTTPConnection
from starlette.websockets import WebSocket

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError
from streamlod.server.api.registry import STOPPING, Registry
from streamlod.server.auth.gate import Gate, Grant, Right
from streamlod.server.http.problems import Problem
from streamlod.server.http.site_policy import is_own_host
from streamlod.server.stream.stream import Stream
from streamlod.server.stream.worker_stream import WorkerStream

_SAFE = {"GET", "HEAD"}  # a foreign page may send them, but cannot read the answer
LINK_ENDED = "the link has expired, or its stream began anew; ask for another"
RECHECK_SECONDS = 5.0  # between two looks at the token of a websocket
_CLOSE_CODES = {401: CloseCode.UNAUTHORISED, 403: CloseCode.FORBIDDEN, 429: CloseCode.BUSY}  # 429 is over in a minute
_REFUSAL_SECONDS = 0.5  # every refusal takes this long, whatever the reason


def registry_of(connection: HTTPConnection) -> Registry:
    """The registry of the application."""
    registry: Registry = connection.app.state.registry
    return registry


def address_of(connection: HTTPConnection) -> str:
    """The peer's network address."""
    return connection.client.host if connection.client else ""


def grant_of(connection: HTTPConnection) -> Grant:
    """The rights of a request that was let in."""
    grant: Grant = connection.state.grant
    return grant


def token_of(connection: HTTPConnection) -> str | None:
    """The bearer token of a request, from its header or, for browsers' websockets, its sub-protocols."""
    scheme, _, token = connection.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and token:
        return token.strip()
    offered = connection.headers.get("sec-websocket-protocol", "")
    return next((p.strip()[7:] for p in offered.split(",") if p.strip().startswith("bearer.")), None)


async def check_right(connection: HTTPConnection, right: Right, stream: str | None) -> None:
    """Let a request go on only with `right`, on `stream` if one is named. Takes the same time for every wrong token.

    Raises:
        Problem: it may not.
    """
    begin, gate = time.monotonic(), registry_of(connection).gate
    if connection.scope.get("method", "GET") not in _SAFE and is_foreign(connection):
        raise Problem(403, "pages of this origin may not change anything here; list it in the setting `origins`")
    _check_address(gate, connection)
    grant = await gate.admit(token_of(connection))
    if grant is None:
        raise await _refused(gate, connection, begin)
    if not grant.allows(right, stream):
        raise Problem(403, f"the token does not give the right to {right.value} here")
    connection.state.grant = grant


def _check_address(gate: Gate, connection: HTTPConnection) -> None:
    if gate.is_blocked(address_of(connection)):
        raise Problem(429, "too many wrong tokens from this address", {"Retry-After": "60"})


async def _refused(gate: Gate, connection: HTTPConnection, begin: float) -> Problem:
    """The answer to a wrong token, after a while from `begin`."""
    gate.note_refusal(address_of(connection))
    await asyncio.sleep(max(0.0, _REFUSAL_SECONDS - (time.monotonic() - begin)))
    return Problem(401, "a valid token is needed", {"WWW-Authenticate": "Bearer"})


def is_foreign(connection: HTTPConnection) -> bool:
    """Whether a page of another origin than the server's own and those of the settings is behind the request."""
    settings, origin = registry_of(connection).settings, connection.headers.get("origin")
    if not origin or origin in settings.origins:
        return False
    try:
        place = urlsplit(origin).netloc
    except ValueError:
        return True
    return place != connection.headers.get("host") or not is_own_host(place, settings)


async def admit(websocket: WebSocket, right: Right, stream_id: str, *, signed: bool = False) -> Stream:
    """The stream that a websocket may use.

    Args:
        signed: whether the address holds a signature that counts in place of a token, see `is_signed`.

    Raises:
        SessionError: it comes from a foreign page or without `right`, the server stops, or there is no such stream.
    """
    registry = registry_of(websocket)
    if is_foreign(websocket):
        raise SessionError(
            CloseCode.FORBIDDEN, "pages of this origin may not connect; list it in the setting `origins`"
        )
    try:
        if not signed:
            await check_right(websocket, right, stream_id)
    except Problem as problem:
        raise SessionError(_CLOSE_CODES[problem.status], problem.detail) from problem
    if registry.draining:
        raise SessionError(CloseCode.STOPPING, STOPPING)
    if stream_id not in registry.streams and registry.unready:
        raise SessionError(CloseCode.BUSY, "the server is not ready yet; try again later")
    if stream_id not in registry.streams:
        raise SessionError(CloseCode.NO_STREAM, "there is no such stream")
    return registry.streams[stream_id]


def is_signed(websocket: WebSocket, scope: str, stream_id: str) -> bool:
    """Whether the address of a websocket holds a signature for `scope` that counts now."""
    registry = registry_of(websocket)
    registry.gate.look()
    stream = registry.streams.get(stream_id)
    if stream is None or registry.gate.is_blocked(address_of(websocket)):
        return False
    return registry.gate.links.allows(scope, websocket.query_params, stream.incarnation)


async def until_withdrawn(
    connection: HTTPConnection, right: Right, stream_id: str | None, tell: Callable[[Grant], None] = lambda _: None
) -> NoReturn:
    """Look every few seconds whether the token of a connection that lasts still allows what it does.

    Args:
        tell: called with what it allows now.

    Raises:
        SessionError: it does not: it has expired, was withdrawn, or has lost the right.
    """
    gate, token = registry_of(connection).gate, token_of(connection)
    while True:
        await asyncio.sleep(RECHECK_SECONDS)
        grant = await gate.admit(token)
        if grant is None:
            raise SessionError(CloseCode.UNAUTHORISED, "the token has expired or was withdrawn; connect with another")
        if not grant.allows(right, stream_id):
            raise SessionError(CloseCode.FORBIDDEN, f"the token does not give the right to {right.value} here any more")
        tell(grant)


def need(right: Right) -> Any:
    """A dependency that lets a request pass only with `right`, on the stream its path names if it names one."""

    async def check(request: Request) -> None:
        await check_right(request, right, request.path_params.get("stream_id"))

    return Depends(check)


async def _check_download(request: Request) -> None:
    """Let a download pass with the right to read, or by an address that was signed."""
    gate, begin = registry_of(request).gate, time.monotonic()
    gate.look()
    stream_id = request.path_params["stream_id"]
    if "signature" not in request.query_params:
        await check_right(request, Right.READ, stream_id)
        return
    _check_address(gate, request)
    stream = registry_of(request).streams.get(stream_id)
    incarnation = "" if stream is None else stream.incarnation
    if gate.links.allows(request.url.path, request.query_params, incarnation):
        return
    if gate.links.has_ended(request.url.path, request.query_params):  # no guess: players go on asking
        raise Problem(401, LINK_ENDED, {"WWW-Authenticate": "Bearer"})
    raise await _refused(gate, request, begin)


NEED_DOWNLOAD: Any = Depends(_check_download)


def find_stream(stream_id: str, request: Request) -> Stream:
    """The stream that the path names; 404 without."""
    stream = registry_of(request).streams.get(stream_id)
    if stream is None:
        raise Problem(404, f"there is no stream {stream_id!r:.80}")
    return stream


StreamOf = Annotated[Stream, Depends(find_stream)]


def find_worker_stream(stream: StreamOf) -> WorkerStream:
    """The stream that the path names; 409 for one that is made elsewhere."""
    if not isinstance(stream, WorkerStream):
        raise Problem(409, "this stream is made by another server; control it there")
    return stream


WorkerStreamOf = Annotated[WorkerStream, Depends(find_worker_stream)]
