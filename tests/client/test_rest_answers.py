"""Answers that no streamlod server gives: a wrong port, a proxy with its own page, a program with other JSON."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from streamlod.client.remote import ACTIONS, ALONE, remote
from streamlod.client.rest_answers import RecordingInfo, StreamInfo, read
from streamlod.core.errors import InputError

OPTIONS = {"disconnect": {"viewer": "a"}}
STREAM = {"id": "a", "state": "live", "detail": "", "source": "cameras", "epoch": 1, "version": None, "viewers": 0,
          "recording": "off"}  # fmt: skip


@contextmanager
def answering(body: bytes, kind: str, announced: int | None = None) -> Iterator[str]:
    """A program that answers everything alike, and its address."""

    class Handler(BaseHTTPRequestHandler):
        def _answer(self) -> None:
            self.rfile.read(int(self.headers.get("Content-Length", 0)))
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body) if announced is None else announced))
            self.end_headers()
            self.wfile.write(body)

        do_GET = do_POST = do_PATCH = do_DELETE = _answer  # noqa: N815

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


@pytest.mark.long
@pytest.mark.parametrize(
    ("body", "kind"),
    [
        (b"{}", "application/json"),
        (b"[]", "application/json"),
        (b"hello", "application/json"),
        (b"[" * 100_000, "application/json"),
        (b'{"items":[{"id":"a"}],"next_cursor":null}', "application/json; charset=utf-8"),
        (b'{"items":["a"]}', "application/json"),
        (json.dumps(STREAM | {"viewers": "many"}).encode(), "application/json"),
        (b"<html>Sign in</html>", "text/html"),
        (b'data: {"id": "a"}\n\n', "text/event-stream"),
        (b"data: hello\n\n", "text/event-stream"),
    ],
)
def test_other_answers_are_refused_in_one_sentence(body: bytes, kind: str, tmp_path: Path) -> None:
    """By every action; a definition alone may be any object, as it is shown as it is."""
    with answering(body, kind) as address:
        for action in ACTIONS:
            if action == "show" and body.startswith(b"{"):
                continue
            name = None if action in ALONE else "a"
            with pytest.raises(InputError, match="no streamlod server"):
                list(remote(address, action, name, OPTIONS.get(action), tmp_path / "a.slod"))
    assert not list(tmp_path.iterdir())


def test_an_answer_that_breaks_off_is_an_error_of_ours() -> None:
    with answering(b"{}", "application/json", announced=100) as address, pytest.raises(InputError, match="broke off"):
        list(remote(address, "list"))


def test_times_and_unknown_fields_are_read() -> None:
    found = read(
        RecordingInfo,
        {"stream": "a", "deleted": False, "epoch": 1, "begun_at": "2026-11-22T10:00:00Z",
         "last_group_at": "2026-11-22T11:00:00Z", "groups": 1, "packets": 2, "bytes": 3, "new": True},
    )  # fmt: skip
    assert found.begun_at == datetime(2026, 11, 22, 10, tzinfo=UTC)
    assert read(StreamInfo, STREAM).version is None
    with pytest.raises(InputError, match="`detail`"):
        read(StreamInfo, {"id": "a", "state": "live"})


@pytest.mark.parametrize(
    ("action", "options", "fault"),
    [
        ("delete", {"erase": "False"}, "true or false"),
        ("delete", {"erase": "no"}, "true or false"),
        ("delete", {"erase": 0}, "true or false"),
        ("delete", {"ersae": True}, "ersae"),
        ("download", {"epoch": "1"}, "a number"),
        ("download", {"epoch": True}, "a number"),
        ("disconnect", {}, "which viewer"),
        ("start", {"erase": True}, "start does not take erase"),
    ],
)
def test_options_that_cannot_be_used_are_refused_before_anything_is_sent(
    action: str, options: dict[str, object], fault: str
) -> None:
    with pytest.raises(InputError, match=fault):
        list(remote("http://127.0.0.1:9", action, "a", options))
