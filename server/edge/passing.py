"""What an edge does not hold itself: the file that a stream of a recording plays, passed on from the origin."""

from __future__ import annotations

import asyncio
import http.client
from collections.abc import AsyncIterator
from urllib.error import HTTPError

from fastapi import APIRouter, Request, Response
from fastapi.responses import StreamingResponse

from server.api.access import StreamOf, need_download
from server.api.downloads import ANSWERS, RECORDING
from server.api.ranges import FRESH, caching
from server.edge.stream import EdgeStream
from server.http.head import is_head
from server.http.problems import PROBLEMS, Problem

_ASKED = ("Range", "If-Range", "If-None-Match")
_ANSWERED = ("Accept-Ranges", "Content-Disposition", "Content-Length", "Content-Range", "Content-Type", "ETag")
_CHUNK_BYTES = 1 << 18

router = APIRouter(prefix="/v1/streams/{stream_id}", tags=["downloads"], dependencies=[need_download()])


@router.get(
    RECORDING,
    summary="The file that the stream plays",
    response_class=Response,
    responses=ANSWERS | {502: PROBLEMS[502]},
)
async def recording(stream: StreamOf, request: Request) -> Response:
    """The whole `.slod` file behind a stream whose source is a recording, as the origin sends it."""
    assert isinstance(stream, EdgeStream)
    asked = {name: value for name in _ASKED if (value := request.headers.get(name)) is not None}
    path = f"/v1/streams/{stream.id}{RECORDING}"
    try:
        answer = await asyncio.to_thread(stream.origin.open, path, asked, "HEAD" if is_head(request) else "GET")
    except HTTPError as error:
        if error.code not in {304, 404, 416}:
            raise Problem(502, f"the origin answers {error.code}") from error
        answer = error  # type: ignore[assignment]  # it is an answer, too
    except (OSError, http.client.HTTPException) as error:
        raise Problem(502, "the origin does not answer") from error
    headers = {name: value for name in _ANSWERED if (value := answer.headers.get(name)) is not None}
    return StreamingResponse(_body(answer), answer.status, headers | {"Cache-Control": caching(request, FRESH)})


async def _body(answer: http.client.HTTPResponse) -> AsyncIterator[bytes]:
    try:
        while chunk := await asyncio.to_thread(answer.read, _CHUNK_BYTES):
            yield chunk
    finally:
        answer.close()
