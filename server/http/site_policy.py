"""Rights of web pages at this server: names it answers to, origins that may read it, sites that may frame it.

Checked before anything else, for requests and websockets alike.
"""

from __future__ import annotations

import contextlib
import ipaddress
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.cors import CORSMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from streamlod.server.http.problems import problem_response
from streamlod.server.settings import Settings

_REQUEST_HEADERS = ("Authorization", "Content-Type", "If-Match", "If-None-Match", "If-Range", "Range", "Last-Event-ID")
_ANSWER_HEADERS = ("Accept-Ranges", "Content-Disposition", "Content-Range", "ETag", "Location", "Retry-After")
_METHODS = ("GET", "HEAD", "POST", "PATCH", "DELETE")


class SitePolicy:
    """ASGI middleware that holds requests to the settings `hosts`, `origins` and `frame_ancestors`."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._settings = settings
        self._app: ASGIApp = CORSMiddleware(
            app,
            allow_origins=settings.origins,
            allow_methods=_METHODS,
            allow_headers=_REQUEST_HEADERS,
            expose_headers=_ANSWER_HEADERS,
        )
        ancestors = " ".join(("'self'", *settings.frame_ancestors))
        self._headers = {
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Content-Security-Policy": f"frame-ancestors {ancestors}",
        }
        if not settings.frame_ancestors:  # for browsers without the policy above; this header cannot name sites
            self._headers["X-Frame-Options"] = "SAMEORIGIN"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 421 to a request for another name; else pass it on."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        hosts = Headers(scope=scope).getlist("host")  # none in HTTP/1.0, which browsers do not speak
        if len(hosts) > 1 or not all(is_own_host(host, self._settings) for host in hosts):
            await _refuse(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in self._headers.items():
                    headers.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, send_with_headers)


async def _refuse(scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close"})
        return
    detail = "this server does not answer to that name; list it in the setting `hosts`"
    await problem_response(421, detail)(scope, receive, send)


def is_own_host(header: str, settings: Settings) -> bool:
    """Whether a Host header names this server.

    Another site can make its own host name point here (DNS rebinding), and its page would then count as this server's
    page. Where tokens are needed, that gains it nothing, so every name is answered unless `hosts` lists some.
    """
    try:
        name = urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return False
    if settings.has_tokens and not settings.hosts:
        return True
    with contextlib.suppress(ValueError):
        return bool(ipaddress.ip_address(name))
    if name == "localhost" or name.endswith(".localhost"):
        return True
    listed = {settings.host, *settings.hosts, *(urlsplit(origin).hostname or "" for origin in settings.origins)}
    return name in {each.lower() for each in listed if each}
