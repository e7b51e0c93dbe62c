"""HEAD wherever there is GET: the same answer without its body."""

from __future__ import annotations

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

_IS_HEAD = "streamlod.head"


class HeadAsGet:
    """ASGI middleware that passes HEAD requests on as GET; uvicorn leaves out their bodies."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] == "http" and scope["method"] == "HEAD":
            scope = {**scope, "method": "GET", _IS_HEAD: True}
        await self._app(scope, receive, send)


def is_head(request: Request) -> bool:
    """Whether the body will not be sent, so that none has to be made."""
    return bool(request.scope.get(_IS_HEAD))
