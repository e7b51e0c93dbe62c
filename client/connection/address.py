"""Where a stream is watched, from what users have at hand: a websocket's address, or that of the page."""

from __future__ import annotations

from urllib.parse import parse_qs, quote, urlsplit, urlunsplit

from streamlod.core.errors import InputError


def live_address(url: str) -> str:
    """The websocket of a stream; of the page (`http://HOST:PORT/?stream=ID`), that of the stream which it shows.

    Raises:
        InputError: neither.
    """
    parts = urlsplit(url)
    if parts.scheme in {"ws", "wss"}:
        return url
    if parts.scheme not in {"http", "https"}:
        raise InputError(url, "is not a websocket address; it looks like ws://HOST:PORT/v1/streams/main/live")
    stream = parse_qs(parts.query).get("stream", ["main"])[0]
    folder = parts.path.rpartition("/")[0]  # of a proxy, or empty
    path = f"{folder}/v1/streams/{quote(stream, safe='')}/live"
    return urlunsplit((parts.scheme.replace("http", "ws"), parts.netloc, path, "", ""))
