"""Serves the viewer page's files, compressed if the package holds them so and the browser accepts it."""

from __future__ import annotations

import re

import anyio.to_thread
from fastapi.staticfiles import StaticFiles
from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import Scope

CODINGS = {"br": ".br", "gzip": ".gz"}  # content coding, suffix of its files; the smaller ones first


class PageFiles(StaticFiles):
    """A folder with index.html. Browsers cache its files and revalidate them."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """`path` or its compressed twin (`hatch_build.py` makes these)."""
        accepted = _codings(Headers(scope=scope).get("accept-encoding", ""))
        response = await self._packed(path, scope, accepted) or await super().get_response(path, scope)
        response.headers["Cache-Control"] = "no-cache"
        response.headers["Vary"] = "Accept-Encoding"
        return response

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


def _codings(header: str) -> set[str]:
    """The codings that an Accept-Encoding header allows."""
    parts = (part.partition(";") for part in header.lower().replace(" ", "").split(","))
    return {name for name, _, weight in parts if not re.fullmatch(r"q=0(\.0*)?", weight)}
