"""The server that an edge stands before: its address, and what it says about its streams."""

from __future__ import annotations

import json
import re
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar
from urllib.parse import quote, urlsplit

from pydantic import BaseModel, ConfigDict, Field

from streamlod.codec.sound.beside import MAX_CAMERA_NAME, MAX_TIME_NS
from streamlod.core.errors import InputError

if TYPE_CHECKING:
    import httpx

_ADDRESS = re.compile(r"https?://[A-Za-z0-9.:\[\]-]+/?")
_ANSWER_SECONDS = 5.0
REFUSED_SECONDS = 15.0  # until an origin that refuses us is asked again: it counts wrong tokens of an address
_MAX_ANSWER_BYTES = 4 << 20
_MAX_PAGES = 100
_INCARNATION = r"[0-9a-f]{16}"


def is_incarnation(text: str) -> bool:
    """Whether a stream's incarnation can look like that."""
    return re.fullmatch(_INCARNATION, text) is not None


class UnknownStream(BaseModel):
    """The certain part of a STREAM whose source or state only later versions know."""

    model_config = ConfigDict(frozen=True)

    id: str = Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$")
    incarnation: str = Field(pattern=f"^{_INCARNATION}$")
    source: str = Field(max_length=64)
    state: str = Field(max_length=64)


class OriginSound(BaseModel):
    """The sound of a stream, as the origin tells of it."""

    model_config = ConfigDict(frozen=True)

    begin_ns: int = Field(ge=0, le=MAX_TIME_NS)
    channels: int = Field(ge=1, le=2)
    live: bool = False
    camera: str | None = Field(default=None, max_length=MAX_CAMERA_NAME)


class OriginStream(UnknownStream):
    """The fields that an edge takes over from STREAM of docs/protocol.md, checked."""

    source: Literal["cameras", "data", "recording"]
    loop: bool = False
    sound: OriginSound | None = None
    state: Literal["idle", "starting", "live", "degraded", "ended", "failed"]
    detail: str = Field(default="", max_length=4096)
    progress: dict[str, Any] | None = None
    report: dict[str, Any] | None = None
    ingest: dict[str, Any] | None = None
    created_at: datetime


class _Page(BaseModel):
    items: list[Annotated[OriginStream | UnknownStream, Field(union_mode="left_to_right")]] = Field(max_length=1000)
    next_cursor: str | None = Field(default=None, max_length=64)


class _Server(BaseModel):
    edges: list[str] = Field(default=[], max_length=1000)


_Answer = TypeVar("_Answer", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Origin:
    """A server, an edge perhaps.

    Args:
        url: such as ``https://origin.example:8000``.
        token: for reading its streams, where it wants one.

    Raises:
        InputError: not an address.
    """

    url: str
    token: str | None = None

    def __post_init__(self) -> None:
        if not _ADDRESS.fullmatch(self.url):
            raise InputError("--origin", f"{self.url!r:.200} is not an address; write https://origin.example:8000")

    @property
    def headers(self) -> dict[str, str]:
        """Headers of every request."""
        return {"Authorization": f"Bearer {self.token}"} if self.token else {}

    def live_url(self, stream: str) -> str:
        """The live websocket of a stream."""
        parts = urlsplit(self.url)
        return f"{'wss' if parts.scheme == 'https' else 'ws'}://{parts.netloc}/v1/streams/{stream}/live"

    async def streams(self) -> list[OriginStream | UnknownStream]:
        """All its streams that the token may read.

        Raises:
            OSError: it does not answer, refuses, or answers with something else.
        """
        found: list[OriginStream | UnknownStream] = []
        cursor = ""
        for _ in range(_MAX_PAGES):
            page = await self._read(f"/v1/streams?limit=200{cursor}", _Page)
            found += page.items
            if page.next_cursor is None:
                return found
            cursor = "&cursor=" + quote(page.next_cursor, safe="")
        raise OSError("its list of streams does not end")

    async def edges(self) -> tuple[str, ...]:
        """Addresses of its edges.

        Raises:
            OSError: it does not answer, refuses, or answers with something else.
        """
        found = await self._read("/v1/server", _Server)
        return tuple(edge for edge in found.edges if _ADDRESS.fullmatch(edge))

    @asynccontextmanager
    async def open(self, path: str, headers: dict[str, str], method: str = "GET") -> AsyncIterator[httpx.Response]:
        """The answer to a request, of any status; its body is not read yet.

        No redirection is followed: the token is for this server alone.

        Raises:
            OSError: it does not answer, or the answer breaks off.
        """
        import httpx

        asked = {"Accept-Encoding": "identity"} | headers | self.headers
        try:
            async with (
                httpx.AsyncClient(verify=_trusted(), timeout=_ANSWER_SECONDS) as client,
                client.stream(method, self.url.rstrip("/") + path, headers=asked) as answer,
            ):
                yield answer
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise OSError(str(error) or type(error).__name__) from error

    async def _read(self, path: str, kind: type[_Answer]) -> _Answer:
        """A short answer, checked."""
        body = bytearray()
        async with self.open(path, {"Accept": "application/json"}) as answer:
            if answer.status_code == 401:
                raise PermissionError("it answers 401: STREAMLOD_TOKEN must hold a token that is valid there")
            if not answer.is_success:
                raise OSError(f"it answers {answer.status_code}")
            async for chunk in answer.aiter_raw():
                body += chunk
                if len(body) > _MAX_ANSWER_BYTES:
                    raise OSError("its answer is too long")
        try:
            return kind.model_validate(json.loads(body))
        except (ValueError, RecursionError) as error:  # no JSON, or other fields
            raise OSError(f"its answer cannot be used ({str(error)[:200]})") from error


@cache
def _trusted() -> ssl.SSLContext:
    """The certificates that this machine trusts."""
    return ssl.create_default_context()
