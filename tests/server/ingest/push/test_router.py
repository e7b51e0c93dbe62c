"""Capture nodes that leave, and servers that stop, before the node was let in: neither is a fault worth a log."""

from __future__ import annotations

import asyncio
import socket
import threading
from typing import Any

import pytest
from starlette.websockets import WebSocket

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError
from streamlod.server.http.websocket import CONNECTION
from streamlod.server.ingest.push.message import PUSH_SUBPROTOCOL, PushMessage
from tests.attack.test_silent_connections import upgrade
from tests.server.ingest.push.serving import serving_push


class _Intake:
    """Waits to be closed."""

    def __init__(self) -> None:
        self.closed = threading.Event()

    def accept(self, message: PushMessage) -> None:
        raise AssertionError(message)

    def wanted(self) -> dict[str, Any]:
        raise AssertionError

    def close(self) -> None:
        self.closed.set()


def _knock(port: int) -> socket.socket:
    peer = socket.create_connection(("127.0.0.1", port), 60)
    peer.sendall(upgrade(path="/v1/streams/main/ingest", protocol=PUSH_SUBPROTOCOL))
    return peer


def test_the_intake_of_a_node_that_has_left_is_closed(caplog: pytest.LogCaptureFixture) -> None:
    intake, asked = _Intake(), threading.Event()

    async def once_it_has_left(websocket: WebSocket, _: str) -> _Intake:
        assert (await websocket.receive())["type"] == "websocket.connect"
        asked.set()
        assert (await websocket.receive())["type"] == "websocket.disconnect"
        return intake

    with serving_push(once_it_has_left) as port:
        with _knock(port):
            assert asked.wait(60)
        assert intake.closed.wait(60)
    assert caplog.messages == []


@pytest.mark.parametrize("refused", [False, True])
def test_a_server_may_stop_before_a_node_is_let_in(caplog: pytest.LogCaptureFixture, refused: bool) -> None:
    intake, asked = _Intake(), threading.Event()

    async def while_it_stops(websocket: WebSocket, _: str) -> _Intake:
        asked.set()
        while websocket.scope[CONNECTION].is_clear:
            await asyncio.sleep(0)
        if refused:
            raise SessionError(CloseCode.STOPPING, "the server is stopping; connect again")
        return intake

    with serving_push(while_it_stops) as port:
        peer = _knock(port)
        assert asked.wait(60)
    with peer:
        assert b" 500 " in peer.recv(4096)
    assert intake.closed.is_set() is not refused
    assert caplog.messages == []
