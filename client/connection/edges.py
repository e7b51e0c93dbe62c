"""The edges that a server names (`edges` of docs/protocol.md), and which of them is the nearest."""

from __future__ import annotations

import asyncio
import json
import ssl
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from urllib.parse import urlsplit

import httpx

from streamlod.client.playback import edges_in

_MAX_ANSWER_BYTES = 1 << 20
_ANSWER_SECONDS = 2.0
_WEBSOCKETS = {"http": "ws", "https": "wss"}


def at_edges(url: str, edges: Iterable[str]) -> tuple[str, ...]:
    """The live websocket `url` at each edge; with TLS only at those that have it too, since a token goes there."""
    own, found = urlsplit(url), []
    for edge in edges:
        scheme, _, place = edge.rstrip("/").partition("://")
        if scheme == "https" or own.scheme == "ws":
            found.append(f"{_WEBSOCKETS[scheme]}://{place}{own.path}")
    return tuple(found)


async def edges_of(url: str, token: str | None) -> tuple[str, ...]:
    """The edges that the server of the live websocket `url` names; none if it does not answer."""
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    async with _client() as client:
        body = await _read(client, _beside(url, "/v1/server"), headers)
    try:
        found = json.loads(body or b"{}")
    except (ValueError, RecursionError):
        return ()
    return edges_in(found.get("edges")) if isinstance(found, dict) else ()


async def nearest(urls: Iterable[str]) -> str | None:
    """The live websocket of the first of several servers to say that viewers may come; None where none does."""

    async def answer(url: str) -> str | None:
        with suppress(ValueError):  # no address, though it looks like one
            return None if await _read(client, _beside(url, "/readyz"), {}) is None else url
        return None

    places = list(urls)
    if not places:
        return None
    async with _client() as client:
        tasks = [asyncio.create_task(answer(place)) for place in places]
        try:
            for task in asyncio.as_completed(tasks):
                if (found := await task) is not None:
                    return found
            return None
        finally:
            for each in tasks:
                each.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


async def _read(client: httpx.AsyncClient, url: str, headers: dict[str, str]) -> bytes | None:
    """The body of a good answer, None for any other or none in time."""
    body = bytearray()
    with suppress(httpx.HTTPError, httpx.InvalidURL, TimeoutError):
        async with asyncio.timeout(_ANSWER_SECONDS), client.stream("GET", url, headers=headers) as answer:
            async for chunk in answer.aiter_raw():
                body += chunk
                if len(body) > _MAX_ANSWER_BYTES:
                    return None
            return bytes(body) if answer.is_success else None
    return None


def _beside(url: str, path: str) -> str:
    """Another path at the server of a websocket."""
    parts = urlsplit(url)
    return f"{'https' if parts.scheme == 'wss' else 'http'}://{parts.netloc}{path}"


def _client() -> httpx.AsyncClient:
    return httpx.AsyncClient(verify=_trusted(), headers={"Accept-Encoding": "identity"}, timeout=_ANSWER_SECONDS)


@cache
def _trusted() -> ssl.SSLContext:
    """The certificates that this machine trusts."""
    return ssl.create_default_context()
