"""Serves the viewer page's files, compressed if the package holds them so and the browser accepts it."""

from __future__ import annotations

import gzip
import html
import re
from pathlib import Path
from urllib.parse import parse_qs, quote, urlencode

import anyio.to_thread
from fastapi.staticfiles import StaticFiles
from starlette.datastructures import URL, Headers
from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse, Response
from starlette.types import Scope

from streamlod.server.http.public_address import base_of

_PAGE = (".", "index.html")
_OTHERS = {"capture": "capture.html", "cameras": "cameras.html"}
CODINGS = {"br": ".br", "gzip": ".gz"}  # content coding, suffix of its files; the smaller ones first


class PageFiles(StaticFiles):
    """A folder with index.html, capture.html and cameras.html. Browsers cache its files and revalidate them."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """`path` or its compressed twin (`hatch_build.py` makes these)."""
        path = _OTHERS.get(path, path)
        headers = Headers(scope=scope)
        accepted = _codings(headers.get("accept-encoding", ""))
        if path in _PAGE and "sec-fetch-dest" not in headers:
            response: Response = await anyio.to_thread.run_sync(self._previewed, scope, accepted)
        else:
            response = await self._packed(path, scope, accepted) or await super().get_response(path, scope)
        if path in _PAGE:
            address = f"{base_of(HTTPConnection(scope))}oembed?{urlencode({'url': str(_address(scope))})}"
            response.headers["Link"] = f'<{address}>; rel="alternate"; type="application/json+oembed"'
        response.headers["Cache-Control"] = "no-cache"
        response.headers["Vary"] = "Accept-Encoding, Sec-Fetch-Dest" if path in _PAGE else "Accept-Encoding"
        return response

    def _previewed(self, scope: Scope, accepted: set[str]) -> Response:
        """The page with what makers of link previews look for, which is no browser of today: those send Sec-Fetch-Dest.
        It takes whole addresses, so it cannot be part of a file."""
        query = {name: values[0] for name, values in parse_qs(scope["query_string"].decode("latin-1")).items()}
        stream = query.get("stream", "main")
        shown = {name: query[name] for name in ("camera", "t", "epoch") if name in query}
        picture = f"{base_of(HTTPConnection(scope))}v1/streams/{quote(stream, safe='')}/poster.jpg"
        facts = {
            "og:type": "video.other",
            "og:title": f"{stream}: free-viewpoint video",
            "og:site_name": "streamlod",
            "og:url": str(_address(scope).remove_query_params("token")),
            "og:image": f"{picture}?{urlencode(shown)}" if shown else picture,
            "twitter:card": "summary_large_image",
        }
        tags = "".join(f'<meta property="{name}" content="{html.escape(value)}">' for name, value in facts.items())
        place, _ = self.lookup_path("index.html")
        page = Path(place).read_text(encoding="utf-8").replace("</title>", f"</title>{tags}", 1).encode()
        if "gzip" not in accepted:
            return HTMLResponse(page)
        return HTMLResponse(gzip.compress(page), headers={"Content-Encoding": "gzip"})

    async def _packed(self, path: str, scope: Scope, accepted: set[str]) -> Response | None:
        name = "index.html" if path == "." else path
        for coding, suffix in CODINGS.items():
            if coding not in accepted or scope["method"] not in ("GET", "HEAD"):
                continue
            full_path, found = await anyio.to_thread.run_sync(self.lookup_path, name + suffix)
            if found is not None:
                response = self.file_response(full_path, found, scope)  # its type is that of the name without suffix
                response.headers["Content-Encoding"] = coding
                return response
        return None


def _address(scope: Scope) -> URL:
    """The page's address as its reader wrote it."""
    asked = URL(scope=scope)
    return URL(base_of(HTTPConnection(scope)) + asked.path.lstrip("/")).replace(query=asked.query)


def _codings(header: str) -> set[str]:
    """The codings that an Accept-Encoding header allows."""
    parts = (part.partition(";") for part in header.lower().replace(" ", "").split(","))
    return {name for name, _, weight in parts if not re.fullmatch(r"q=0(\.0*)?", weight)}
