"""Changes that hold only for what the client has seen: `ETag` and `If-Match` (RFC 9110 section 13.1.1)."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends, Header

from streamlod.server.api.access import StreamOf
from streamlod.server.http.problems import Problem
from streamlod.server.stream.stream import Stream
from streamlod.server.stream.worker_stream import WorkerStream


def tag_headers(stream: Stream) -> dict[str, str]:
    """The tag of what a stream is made from; its state, which changes all the time, has none."""
    return {"ETag": f'"{stream.etag}"'} if isinstance(stream, WorkerStream) else {}


IfMatchHeader = Annotated[str | None, Header(max_length=1000, description="change it only if its ETag is this")]


def check_match(stream: StreamOf, if_match: IfMatchHeader = None) -> None:
    """Refuse a change with 412 where the stream is made from something else than the client believes."""
    if if_match is None or if_match.strip() == "*" or not isinstance(stream, WorkerStream):
        return
    if f'"{stream.etag}"' not in [tag.strip() for tag in if_match.split(",")]:  # weak tags never match
        raise Problem(412, "the stream was changed meanwhile; read it again", tag_headers(stream))


IfMatch: Any = Depends(check_match)
