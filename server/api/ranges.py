"""Downloads joined from bytes and parts of files: ranges of bytes and of time, strong ETags, conditions (RFC 9110)."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated

from fastapi import Depends, Query, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import BeforeValidator

from streamlod.codec.container import FilePart, Piece, size_of
from streamlod.server.api.access import registry_of
from streamlod.server.http.head import is_head
from streamlod.server.http.problems import Problem
from streamlod.server.stream.time_range import TimeRange

_CHUNK_BYTES = 1 << 20
_RANGE = re.compile(r"bytes=(\d*)-(\d*)")
_DATE = re.compile(r"\d{4}-\d\d-\d\d[Tt ]")
IMMUTABLE = "max-age=31536000, immutable"
FRESH = "no-cache"


@dataclass(frozen=True, slots=True)
class Download:
    """A body in pieces.

    Attributes:
        pieces: in order.
        etag: strong validator, without quotes.
        media_type: of the whole.
        caching: Cache-Control after ``private`` or ``public``.
        name: file name offered.
    """

    pieces: tuple[Piece, ...]
    etag: str
    media_type: str
    caching: str
    name: str

    @property
    def size(self) -> int:
        """Bytes of all pieces."""
        return sum(map(size_of, self.pieces))


def respond(request: Request, download: Download) -> Response:
    """The answer to a GET or HEAD for `download`.

    Raises:
        Problem: 416, the range lies outside.
    """
    size, etag = download.size, f'"{download.etag}"'
    headers = {
        "ETag": etag,
        "Accept-Ranges": "bytes",
        "Cache-Control": caching(request, download.caching),
        "Content-Disposition": f'attachment; filename="{download.name}"',
    }
    offered = request.headers.get("if-none-match", "").split(",")
    known = [each.strip().removeprefix("W/") for each in offered]  # weak comparison
    if "*" in known or etag in known:
        return Response(status_code=304, headers=headers)
    begin, end, status = 0, size, 200
    condition = request.headers.get("if-range")
    if not is_head(request) and (condition is None or condition.strip() == etag):
        asked = _parse_range(request.headers.get("range"), size)
        if asked is not None:
            (begin, end), status = asked, 206
            headers["Content-Range"] = f"bytes {begin}-{end - 1}/{size}"
    headers["Content-Length"] = str(end - begin)
    if is_head(request):
        return Response(status_code=200, headers=headers, media_type=download.media_type)
    return StreamingResponse(_read(download, begin, end), status, headers, download.media_type)


def caching(request: Request, rule: str) -> str:
    """Cache-Control of an answer: shared caches may keep what needs neither a token nor a signature.

    They would give what was signed for one, for a time, to all and for good.
    """
    return f"{'public' if registry_of(request).gate.is_open else 'private'}, {rule}"


def _parse_range(header: str | None, size: int) -> tuple[int, int] | None:
    """Begin and end of the one range asked for; None where the header is absent, malformed or names several."""
    match = _RANGE.fullmatch(header.strip()) if header and len(header) < 100 else None
    if match is None or match.group(0) == "bytes=-":
        return None
    first, last = match.groups()
    if not first:
        begin, end = max(0, size - int(last)), size
    else:
        begin, end = int(first), min(size, int(last) + 1) if last else size
        if last and int(last) < begin:
            return None
    if begin >= size or end <= begin:
        raise Problem(416, f"the content has {size} bytes", {"Content-Range": f"bytes */{size}"})
    return begin, end


async def _read(download: Download, begin: int, end: int) -> AsyncIterator[bytes]:
    at = 0
    for piece in download.pieces:
        size = size_of(piece)
        first, last = max(begin - at, 0), min(end - at, size)
        at += size
        while first < last:
            stop = min(last, first + _CHUNK_BYTES)
            if isinstance(piece, bytes):
                yield piece[first:stop]
            else:
                yield await asyncio.to_thread(_read_part, piece, first, stop - first)
            first = stop


def _read_part(part: FilePart, begin: int, count: int) -> bytes:
    with part.path.open("rb") as file:
        file.seek(part.offset + begin)
        data = file.read(count)
    if len(data) != count:
        raise OSError(f"{part.path.name} became shorter while it was read")
    return data


def _with_date(value: object) -> object:
    if isinstance(value, str) and not _DATE.match(value):  # pydantic takes numbers, for seconds or milliseconds
        raise ValueError("is no RFC 3339 time, such as 2026-11-26T09:00:00Z")
    return value


_Time = Annotated[datetime | None, BeforeValidator(_with_date)]


def _time_range(
    begin: Annotated[_Time, Query(alias="from", description="RFC 3339 time, inclusive")] = None,
    end: Annotated[_Time, Query(alias="to", description="RFC 3339 time, exclusive")] = None,
) -> TimeRange:
    found = TimeRange(_nanoseconds(begin), _nanoseconds(end))
    if found.begin_ns is not None and found.end_ns is not None and found.end_ns <= found.begin_ns:
        raise Problem(422, "`to` must be later than `from`")
    return found


def _nanoseconds(time: datetime | None) -> int | None:
    if time is None:
        return None
    try:
        known = time if time.tzinfo is not None else time.replace(tzinfo=UTC)
        return int(known.timestamp() * 1e6) * 1000
    except (OverflowError, ValueError) as error:
        raise Problem(422, "a time is out of range") from error


WallClock = Annotated[TimeRange, Depends(_time_range)]
