"""Web pages of others that use a visitor's browser to reach a server on the visitor's machine."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.frames import Close
from websockets.sync.client import connect

from streamlod.server.settings import Settings
from tests.server.conftest import UNWATCHED, Running, running

_FOREIGN = {
    "another site": {"Origin": "http://elsewhere.example"},
    "a name that leads here": {"Origin": "http://elsewhere.example", "Host": "elsewhere.example"},
    "no origin at all": {"Origin": "null"},
    "rubbish": {"Origin": "http://[", "Host": "["},
}


def closed(server: Running, headers: dict[str, str]) -> Close:
    """How a websocket without hello is closed."""
    host = headers.get("Host", "localhost")
    options: Any = {"origin": headers["Origin"], "subprotocols": ["streamlod.v1"]}
    with (
        socket.create_connection(("127.0.0.1", server.port)) as peer,
        connect(f"ws://{host}/v1/streams/main/live", sock=peer, **options) as viewer,
    ):
        with contextlib.suppress(ConnectionClosed):  # refused already
            viewer.send("{}")
        with pytest.raises(ConnectionClosed) as caught:
            viewer.recv(60)
    assert caught.value.rcvd is not None
    return caught.value.rcvd


def test_foreign_pages_change_nothing_and_watch_nothing() -> None:
    with running(Settings(), UNWATCHED) as server, server.client() as client:
        for name, headers in _FOREIGN.items():
            refused = 421 if "Host" in headers else 403
            answer = client.post("/v1/streams/main/stop", headers=headers)
            assert answer.status_code == refused, name
            if "Host" not in headers:
                assert "list it in the setting `origins`" in answer.json()["detail"], "programs learn what is missing"
                close = closed(server, headers)
                assert close.code == 4403, name
                assert "list it in the setting `origins`" in close.reason
        for own in (f"127.0.0.1:{server.port}", f"localhost:{server.port}", "[::1]:8080"):
            headers = {"Origin": f"http://{own}", "Host": own}
            assert client.post("/v1/streams/main/stop", headers=headers).status_code == 202, own
            assert closed(server, headers).code == 4400, own


def test_origins_of_the_settings_and_names_of_a_server_with_tokens_count_as_own(tmp_path: Path) -> None:
    known = {"Origin": "https://stage.example", "Host": "stage.example"}
    with running(Settings(origins=("https://stage.example",)), UNWATCHED) as server, server.client() as client:
        assert client.post("/v1/streams/main/stop", headers=known).status_code == 202
    (tmp_path / "tokens").write_text("[]")
    with running(Settings(tokens=tmp_path / "tokens"), UNWATCHED) as server, server.client() as client:
        assert client.post("/v1/streams/main/stop", headers=known).status_code == 401
