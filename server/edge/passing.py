"""Requests for what an edge does not hold, passed on from the origin: files that a stream plays, and HLS."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING, Annotated

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.responses import StreamingResponse

from streamlod.codec.mp4.playlist import MEDIA_TYPE, with_query
from streamlod.codec.sound.beside import MAX_TIME_NS
from streamlod.server.api.access import NEED_DOWNLOAD, StreamOf
from streamlod.server.api.downloads import ANSWERS, RECORDING, SOUND
from streamlod.server.api.hls.routes import HLS
from streamlod.server.api.ranges import FRESH, caching
from streamlod.server.edge.origin import Origin
from streamlod.server.http.head import is_head
from streamlod.server.http.problems import Problem, problems

if TYPE_CHECKING:
    import httpx

_ASKED = ("Range", "If-Range", "If-None-Match")
_ANSWERED = ("Accept-Ranges", "Content-Disposition", "Content-Length", "Content-Range", "Content-Type", "ETag")
_PASSED_ON = {200, 206, 304, 404, 416}
_CHUNK_BYTES = 1 << 18
_SEGMENTS = r"(recording|[0-9a-f]{16}/[0-9]{1,10})/(parts/[0-9]{1,10}-)?[0-9]{1,10}\.m4s"
TimeNs = Annotated[int, Query(ge=0, le=MAX_TIME_NS, description="of live sound, as packets count")]
_NAMES = rf"^(index\.m3u8|init\.mp4|{_SEGMENTS})$"  # below HLS, and nothing that leads out of it

router = APIRouter(prefix="/v1/streams/{stream_id}", tags=["downloads"], dependencies=[NEED_DOWNLOAD])


@router.get(
    RECORDING,
    summary="The file that the stream plays",
    response_class=Response,
    responses=ANSWERS | problems(502),
)
async def recording(stream: StreamOf, request: Request) -> Response:
    """The whole `.slod` file behind a stream whose source is a recording, as the origin sends it."""
    return await _pass_on(request, f"/v1/streams/{stream.id}{RECORDING}")


@router.get(
    SOUND,
    summary="The sound of the stream",
    response_class=Response,
    responses=ANSWERS | problems(502),
)
async def sound(stream: StreamOf, request: Request, from_ns: TimeNs = 0, to_ns: TimeNs | None = None) -> Response:
    """The Ogg Opus file that belongs to the recording, or is made of live sound, as the origin sends it."""
    times = f"?from_ns={from_ns}" + ("" if to_ns is None else f"&to_ns={to_ns}")
    return await _pass_on(request, f"/v1/streams/{stream.id}{SOUND}{times}")


@router.get(
    HLS + "/{name:path}",
    summary="HLS playlist and its segments",
    response_class=Response,
    responses=ANSWERS | problems(502),
)
async def hls(stream: StreamOf, request: Request, name: Annotated[str, Path(pattern=_NAMES)]) -> Response:
    """The playlist and segments of the origin. A signature goes on to all that the playlist names."""
    answer = await _pass_on(request, f"/v1/streams/{stream.id}{HLS}/{name}")
    if name != "index.m3u8" or "signature" not in request.query_params or answer.status_code != 200:
        return answer
    text = b"".join([bytes(chunk) async for chunk in answer.body_iterator if not isinstance(chunk, str)]).decode()
    headers = {"Cache-Control": answer.headers["cache-control"]}
    return Response(with_query(text, request.url.query), headers=headers, media_type=MEDIA_TYPE)


async def _pass_on(request: Request, path: str) -> StreamingResponse:
    """The origin's answer to the same request for `path`."""
    origin: Origin = request.app.state.origin
    asked = {name: value for name in _ASKED if (value := request.headers.get(name)) is not None}
    connection = AsyncExitStack()  # open until the body has been passed on
    try:
        answer = await connection.enter_async_context(origin.open(path, asked, "HEAD" if is_head(request) else "GET"))
    except OSError as error:
        raise Problem(502, "the origin does not answer") from error
    if answer.status_code not in _PASSED_ON:
        await connection.aclose()
        raise Problem(502, f"the origin answers {answer.status_code}")
    headers = {name: value for name in _ANSWERED if (value := answer.headers.get(name)) is not None}
    headers["Cache-Control"] = caching(request, FRESH)
    return StreamingResponse(_body(connection, answer), answer.status_code, headers)


async def _body(connection: AsyncExitStack, answer: httpx.Response) -> AsyncIterator[bytes]:
    async with connection:
        async for chunk in answer.aiter_raw(_CHUNK_BYTES):
            yield chunk
