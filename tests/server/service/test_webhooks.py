"""Webhooks against a real web server on loopback: signed, tried again, and not sent where they must not go."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from streamlod.core.errors import InputError
from streamlod.server.auth.secret_file import read_secret
from streamlod.server.http.networks import check_places
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.service.app import create_app
from streamlod.server.service.webhooks import signature
from streamlod.server.settings import Settings, Webhook
from tests.server.conftest import running
from tests.waiting import wait

_KEY = b"k" * 40
_STREAM = StreamSpec(play=Path("nothing.slod"))


@contextmanager
def receiver(*statuses: int) -> Iterator[tuple[str, list[tuple[dict[str, str], bytes]]]]:
    """A program that answers with these statuses, the last one again and again; and what it was sent."""
    received: list[tuple[dict[str, str], bytes]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            received.append(({name.lower(): value for name, value in self.headers.items()}, body))
            self.send_response(statuses[min(len(received), len(statuses)) - 1])
            self.send_header("Location", "/elsewhere")
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://localhost:{server.server_port}/hook", received
    finally:
        server.shutdown()
        server.server_close()


def settings_for(folder: Path, url: str, networks: tuple[str, ...] = ("localhost",), **fields: Any) -> Settings:
    (folder / "key").write_bytes(_KEY + b"\n")
    return Settings(networks=networks, webhooks=(Webhook(url=url, key=folder / "key", **fields),))


def test_an_event_is_signed_and_tried_again_until_it_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("streamlod.server.service.webhooks.RETRY_SECONDS", (0.05, 0.05, 0.05))
    with receiver(500, 302, 204) as (url, received):
        with running(settings_for(tmp_path, url, events=("stream.*",), streams="ma*"), _STREAM):
            wait(lambda: len(received) >= 4)  # three attempts for `starting`, and then `failed`
        bodies = [json.loads(body) for _, body in received]
        assert bodies[0] == bodies[1] == bodies[2]
        assert [body["data"]["state"] for body in bodies[2:4]] == ["starting", "failed"]
        headers, body = received[0]
        seconds = int(headers["webhook-timestamp"])
        assert abs(seconds - time.time()) < 60
        assert headers["webhook-signature"] == signature(_KEY, bodies[0]["id"], seconds, body)
        assert headers["webhook-id"] == bodies[0]["id"]
        assert headers["host"] == url.split("/")[2]


def test_an_event_that_nobody_takes_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("streamlod.server.service.webhooks.RETRY_SECONDS", (0.01, 0.02))
    with receiver(500) as (url, received), running(settings_for(tmp_path, url), _STREAM):
        wait(lambda: len(received) >= 6)
        kinds = [json.loads(body)["data"]["state"] for _, body in received]
        assert kinds == ["starting"] * 3 + ["failed"] * 3
    told = [text.rpartition("; ")[2] for text in caplog.messages if "is not delivered" in text]
    assert told[:3] == ["it is sent again in 0.01 s", "it is sent again in 0.02 s", "it is given up"]


@pytest.mark.parametrize("networks", [(), ("10.0.0.0/8",)])
def test_nothing_is_sent_into_networks_that_are_not_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, networks: tuple[str, ...]
) -> None:
    monkeypatch.setattr("streamlod.server.service.webhooks.RETRY_SECONDS", (0.01,))
    with receiver(200) as (url, received), running(settings_for(tmp_path, url, networks), _STREAM) as server:
        server.wait(lambda stream: stream["state"] == "failed")
        limit = time.monotonic() + 60
        while "`networks`" not in caplog.text:
            assert time.monotonic() < limit
            time.sleep(0.01)
    assert received == []


@pytest.mark.parametrize("place", ["a:99999", "a:b", "[a]", "a..b"])
def test_settings_that_hold_no_address_are_refused(tmp_path: Path, place: str) -> None:
    hook = Webhook(url=f"http://{place}/hook", key=tmp_path)
    for fields in ({"webhooks": (hook,)}, {"trace_endpoint": f"http://{place}"}, {"jwks": f"https://{place}/set"}):
        with pytest.raises(InputError, match="is no address"):
            check_places(Settings.model_validate(fields))


def test_an_address_with_a_control_character_does_not_end_delivery(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("streamlod.server.service.webhooks.RETRY_SECONDS", ())
    with receiver(200) as (url, received), running(settings_for(tmp_path, f"{url}\x01"), _STREAM):
        wait(lambda: caplog.text.count("non-printable") >= 2)  # of `starting`, and then of `failed`
    assert received == []


def test_unusable_webhooks_are_refused(tmp_path: Path) -> None:
    (tmp_path / "short").write_text("secret")
    for path in (tmp_path / "none", tmp_path / "short"):
        with pytest.raises(InputError, match=str(path)):
            read_secret(path)
    for url in ("ftp://x/y", "http://user:word@x/", "//x", "http:///x"):
        with pytest.raises(ValueError, match="url"):
            Webhook(url=url, key=tmp_path)
    assert create_app(Settings()) is not None
