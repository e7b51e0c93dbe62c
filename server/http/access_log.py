"""A line of the log for every HTTP request: who asked, for what, the answer, its bytes and its time.

Queries are left out, as they may hold signatures.
"""

from __future__ import annotations

import logging
import time

from starlette.types import ASGIApp, Message, Receive, Scope, Send

ACCESS = "streamlod.access"
_LOG = logging.getLogger(ACCESS)
_MAX_PATH = 500  # characters


class AccessLog:
    """ASGI middleware."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and log it when it is over, however it ends."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begin, status, size = time.monotonic(), 0, 0

        async def counted(message: Message) -> None:
            nonlocal status, size
            if message["type"] == "http.response.start":
                status = message["status"]
            size += len(message.get("body", b""))
            await send(message)

        try:
            await self._app(scope, receive, counted)
        finally:
            client = scope.get("client")
            facts = {
                "address": client[0] if client else "",
                "method": scope["method"],
                "path": scope["path"][:_MAX_PATH],
                "status": status,
                "bytes": size,
                "milliseconds": round(1000 * (time.monotonic() - begin), 1),
            }
            _LOG.info("%(address)s %(method)s %(path)r %(status)d %(bytes)d B %(milliseconds)g ms", facts,
                      extra={"facts": facts})  # fmt: skip
