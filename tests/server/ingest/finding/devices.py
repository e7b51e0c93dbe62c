"""A network camera's services on loopback, which answer as a device does, or as the test wants."""

from __future__ import annotations

import base64
import hashlib
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from streamlod.server.ingest.finding.onvif import NetworkCamera

_SOAP = 'xmlns:s="http://www.w3.org/2003/05/soap-envelope" xmlns:tt="http://www.onvif.org/ver10/schema"'
_MEDIA = 'xmlns:trt="http://www.onvif.org/ver10/media/wsdl"'
_PROFILE = """<trt:Profiles token="{token}"><tt:Name>{token}</tt:Name>
<tt:VideoSourceConfiguration><tt:SourceToken>{source}</tt:SourceToken></tt:VideoSourceConfiguration>
<tt:VideoEncoderConfiguration><tt:Encoding>H264</tt:Encoding><tt:Resolution><tt:Width>{width}</tt:Width>
<tt:Height>{height}</tt:Height></tt:Resolution></tt:VideoEncoderConfiguration></trt:Profiles>"""
_NOT_AUTHORISED = """<s:Fault><s:Code><s:Value>s:Sender</s:Value><s:Subcode><s:Value>ter:NotAuthorized</s:Value>
</s:Subcode></s:Code><s:Reason><s:Text>Sender not authorized</s:Text></s:Reason></s:Fault>"""
_LATE = timedelta(seconds=5)


@dataclass
class Device:
    """A camera with two lenses, the first of which has two streams.

    Attributes:
        password: of the user `film`; None where nobody needs one.
        ahead: how far its clock is ahead of ours.
        instead: bodies that it sends to questions, by their names, in place of its own.
        host: that it names in its addresses.
        asked: the questions that came, each with whether it had a login.
    """

    password: str | None = None
    ahead: timedelta = timedelta()
    instead: dict[str, bytes] = field(default_factory=dict)
    host: str = "127.0.0.1"
    asked: list[tuple[str, bool]] = field(default_factory=list)
    port: int = 0

    @property
    def camera(self) -> NetworkCamera:
        """As it answers a probe."""
        return NetworkCamera("127.0.0.1", "Hall", f"http://127.0.0.1:{self.port}/onvif/device_service")

    def answer(self, question: str) -> tuple[int, bytes]:
        """Status and body."""
        found = re.search(r"<s:Body><(\w+)", question)
        name = found[1] if found else ""
        self.asked.append((name, "UsernameToken" in question))
        if name in self.instead:
            return 200, self.instead[name]
        if name.startswith(("GetProfiles", "GetStreamUri")) and not self._lets_in(question):
            return 400, self._envelope(_NOT_AUTHORISED)
        return 200, self._envelope(getattr(self, f"_{name}")(question))

    def _lets_in(self, question: str) -> bool:
        if self.password is None:
            return True
        parts = [re.search(rf"<\w:{name}\b[^>]*>([^<]*)<", question) for name in ("Username", "Password", "Nonce")]
        created = re.search(r"<u:Created[^>]*>([^<]*)<", question)
        if created is None or None in parts:
            return False
        user, digest, nonce = (part[1] for part in parts)
        hashed = hashlib.sha1(base64.b64decode(nonce) + (created[1] + self.password).encode()).digest()
        since = datetime.now(UTC) + self.ahead - datetime.fromisoformat(created[1])
        return user == "film" and digest == base64.b64encode(hashed).decode() and abs(since) < _LATE

    def _envelope(self, body: str) -> bytes:
        return f'<?xml version="1.0"?><s:Envelope {_SOAP} {_MEDIA}><s:Body>{body}</s:Body></s:Envelope>'.encode()

    def _GetSystemDateAndTime(self, _: str) -> str:  # noqa: N802 - as ONVIF names it
        now = datetime.now(UTC) + self.ahead
        time = f"<tt:Hour>{now.hour}</tt:Hour><tt:Minute>{now.minute}</tt:Minute><tt:Second>{now.second}</tt:Second>"
        date = f"<tt:Year>{now.year}</tt:Year><tt:Month>{now.month}</tt:Month><tt:Day>{now.day}</tt:Day>"
        return f"<tt:UTCDateTime><tt:Time>{time}</tt:Time><tt:Date>{date}</tt:Date></tt:UTCDateTime>"

    def _GetCapabilities(self, _: str) -> str:  # noqa: N802
        return f"<tt:Media><tt:XAddr>http://{self.host}:{self.port}/onvif/media?a=1</tt:XAddr></tt:Media>"

    def _GetProfiles(self, _: str) -> str:  # noqa: N802
        rows = [("sub", "front", 640, 360), ("main<1>", "front", 1920, 1080), ("back", "rear", 1280, 720)]
        names = ("token", "source", "width", "height")
        profiles = [_PROFILE.format(**dict(zip(names, row, strict=True))) for row in rows]
        return "".join(profiles).replace("main<1>", "main&lt;1&gt;")

    def _GetStreamUri(self, question: str) -> str:  # noqa: N802
        found = re.search(r"ProfileToken>([^<]*)<", question)
        token = found[1] if found else ""
        path = {"main&lt;1&gt;": "front?channel=1&amp;subtype=0", "back": "rear", "sub": "small"}[token]
        return f"<tt:Uri>rtsp://someone:else@{self.host}:8554/{path}</tt:Uri>"


@contextmanager
def serving(device: Device) -> Iterator[Device]:
    """Answer while the context lasts."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            question = self.rfile.read(int(self.headers["Content-Length"])).decode()
            status, body = device.answer(question)
            self.send_response(status)
            self.send_header("Location", "http://127.0.0.1:1/elsewhere")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    device.port = server.server_address[1]
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield device
    finally:
        server.shutdown()
        server.server_close()
        thread.join(60)
