"""Where a stream is watched, from what users have at hand: a websocket's address, or that of the page."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import parse_qs, quote, urlunsplit

from streamlod.core.errors import InputError
from streamlod.core.web_address import address_parts


def live_address(url: str) -> str:
    """The websocket of a stream, from its own address, that of the page (`http://HOST:PORT/?stream=ID`) or of REST.

    Where the page's address names no stream, it is `main`.

    Raises:
        InputError: neither, or no address.
    """
    parts = address_parts("the stream", url)
    if parts.scheme in {"ws", "wss"}:
        return url
    if parts.scheme not in {"http", "https"} and Path(url).is_file():
        raise InputError(url, "is a file; `streamlod serve --play` it, and watch the address that that logs")
    if parts.scheme not in {"http", "https"}:
        raise InputError(url, "is no stream; it looks like http://HOST:PORT or ws://HOST:PORT/v1/streams/main/live")
    folder, found, rest = parts.path.partition("/v1/streams/")  # before it, what a proxy adds
    if found:
        stream = rest.partition("/")[0]
    else:
        folder = folder.rpartition("/")[0]
        stream = quote(parse_qs(parts.query).get("stream", ["main"])[0], safe="")
    path = f"{folder}/v1/streams/{stream}/live"
    return urlunsplit((parts.scheme.replace("http", "ws"), parts.netloc, path, "", ""))
