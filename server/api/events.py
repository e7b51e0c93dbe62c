"""The event feed: server-sent events of streams and viewers."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import StreamingResponse

from streamlod.core.errors import SessionError
from streamlod.server.api.access import grant_of, need, registry_of, until_withdrawn
from streamlod.server.api.registry import Registry
from streamlod.server.auth.gate import Grant, Right
from streamlod.server.http.head import is_head
from streamlod.server.http.problems import Problem, problems
from streamlod.server.stream.feed import ServerEvent

_TYPE = "text/event-stream"
_HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}  # the latter for nginx
_QUIET_SECONDS = 15.0  # after which a comment keeps proxies from closing the connection
_TICK_SECONDS = 0.5
_MAX_READERS = 100
_MAX_WAITING = 1000
_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"content": {_TYPE: {"schema": {"type": "string"}}}},
    **problems(401, 403, 422, 429, 503),
}
router = APIRouter(tags=["events"], dependencies=[need(Right.READ)])


@router.get("/v1/events", summary="What happens", response_class=StreamingResponse, responses=_ANSWERS)
async def watch_events(
    request: Request,
    stream: Annotated[str | None, Query(max_length=64, description="of this stream only")] = None,
    seconds: Annotated[float, Query(gt=0, le=86400, description="end after so long")] = 86400,
    last_event_id: Annotated[
        str | None, Header(max_length=64, description="send what happened since, as far as it is kept")
    ] = None,
) -> Response:
    """Events as they happen, each an EVENT of docs/protocol.md: of streams that the token may read, and of viewers for
    those with the right to control. A reader that is too slow is disconnected, and comes back with `Last-Event-ID`."""
    registry = registry_of(request)
    if is_head(request):
        return Response(media_type=_TYPE, headers=_HEADERS)
    if len(registry.feed.listeners) >= _MAX_READERS:
        raise Problem(503, f"{_MAX_READERS} programs read events already")
    waiting: asyncio.Queue[ServerEvent] = asyncio.Queue(_MAX_WAITING)
    for event in registry.feed.after(last_event_id) if last_event_id is not None else ():
        waiting.put_nowait(event)
    return StreamingResponse(_events(request, registry, waiting, stream, seconds), headers=_HEADERS, media_type=_TYPE)


async def _events(
    request: Request, registry: Registry, waiting: asyncio.Queue[ServerEvent], stream: str | None, seconds: float
) -> AsyncIterator[str]:
    grant, overflown = grant_of(request), asyncio.Event()

    def take(event: ServerEvent) -> None:
        if waiting.full():
            overflown.set()
        else:
            waiting.put_nowait(event)

    registry.feed.listeners.add(take)
    checking = asyncio.create_task(_until_withdrawn(request))
    begun = quiet_since = time.monotonic()
    try:
        yield ": the feed of streamlod\n\n"
        while not (checking.done() or registry.draining or overflown.is_set()) and time.monotonic() < begun + seconds:
            try:
                async with asyncio.timeout(_TICK_SECONDS):
                    event = await waiting.get()
            except TimeoutError:
                if time.monotonic() - quiet_since > _QUIET_SECONDS:
                    quiet_since = time.monotonic()
                    yield ":\n\n"
                continue
            if stream in (None, event.stream) and _may_see(grant, event):
                quiet_since = time.monotonic()
                yield f"id: {event.id}\nevent: {event.type}\ndata: {json.dumps(event.to_json())}\n\n"
    finally:
        registry.feed.listeners.discard(take)
        checking.cancel()
        await asyncio.gather(checking, return_exceptions=True)


async def _until_withdrawn(request: Request) -> None:
    try:
        await until_withdrawn(request, Right.READ, None)
    except SessionError:
        return


def _may_see(grant: Grant, event: ServerEvent) -> bool:
    right = Right.CONTROL if event.type.startswith("viewer.") else Right.READ
    return grant.allows(right, event.stream)
