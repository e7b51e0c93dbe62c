"""A camera's HTTP address that leads elsewhere: redirections and playlists are not followed."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from streamlod.server.ingest.cameras.address import parse_address
from streamlod.server.ingest.cameras.reader import Reader
from streamlod.server.ingest.sync.timeline import Timeline
from tests.waiting import wait

_PLAYLIST = "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{url}\n#EXT-X-ENDLIST\n"
_DASH = '<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011"><BaseURL>{url}</BaseURL></MPD>'
_CONCAT = "ffconcat version 1.0\nfile '{url}'\n"
_SDP = "v=0\nc=IN IP4 127.0.0.1\nm=video 5004 RTP/AVP 96\n"


@contextmanager
def answering(status: int, headers: dict[str, str], body: str) -> Iterator[tuple[str, list[str]]]:
    """A web server on loopback: its address, and the paths that were asked of it."""
    asked: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            self.send_response(status)
            for name, value in {**headers, "Content-Length": str(len(body))}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body.encode())

        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", asked
    finally:
        server.shutdown()
        server.server_close()


class Faults:
    """A reader's sink that remembers why the camera delivers nothing."""

    def __init__(self) -> None:
        self.reasons: list[str] = []

    def put(self, picture: Any) -> None:
        raise AssertionError("there is no picture")

    def gone(self, camera: str, reason: str, *, ended: bool) -> None:
        self.reasons.append(reason)


@pytest.mark.long
@pytest.mark.parametrize(
    ("status", "kind", "body"),
    [
        (302, "text/plain", ""),
        (200, "application/vnd.apple.mpegurl", _PLAYLIST),
        (200, "application/dash+xml", _DASH),
        (200, "text/plain", _CONCAT),
        (200, "application/sdp", _SDP),
    ],
    ids=["redirection", "HLS", "DASH", "concatenation", "SDP"],
)
def test_an_address_leads_nowhere_else(status: int, kind: str, body: str) -> None:
    with answering(200, {}, "secret") as (inside, asked_inside):
        headers = {"Content-Type": kind, "Location": f"{inside}/secret"}
        with answering(status, headers, body.format(url=f"{inside}/secret")) as (outside, asked_outside):
            sink = Faults()
            address = parse_address(f"{outside}/camera.m3u8")
            reader = Reader("cam0", address, (64, 48), 10.0, sink, Timeline(), anchor_ns=0)
            reader.start()
            wait(lambda: sink.reasons)
            reader.stop()
            reader.join(60)
            assert asked_outside
        assert asked_inside == []
