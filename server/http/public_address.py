"""The server's address as its clients write it, which its answers hold where a whole address is needed."""

from __future__ import annotations

import re

from starlette.requests import HTTPConnection

_PATH = re.compile(r"(/[A-Za-z0-9_~-][A-Za-z0-9._~-]*)+/?")


def base_of(connection: HTTPConnection) -> str:
    """Scheme, host and path of the server, with a slash at its end.

    A proxy that shows the server under a path names it in X-Forwarded-Prefix. No address of the server itself depends
    on it, and a path cannot lead to another host, so it is believed from everybody; what is no path is ignored.
    """
    prefix = connection.headers.get("x-forwarded-prefix", "")
    path = f"{prefix.strip('/')}/" if _PATH.fullmatch(prefix) else ""
    return f"{connection.base_url}{path}"
