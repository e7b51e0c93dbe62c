"""Connections that say nothing, or never the whole: none stays open, whatever state it has reached."""

from __future__ import annotations

import contextlib
import random
import socket
import time

import pytest

from streamlod.server.http import websocket
from streamlod.server.service import run
from streamlod.server.settings import Limits, Settings
from tests.server.conftest import UNWATCHED, Running, running
from tests.server.test_faults import HANDSHAKE, masked

_LIMITS = Limits(request_seconds=0.6, hello_seconds=0.4, stuck_seconds=0.5, connections=4000)
_OTHER_SECONDS = 5  # that a connection has at most beyond those of a kept-alive one, on a busy machine


def connected(server: Running, data: bytes) -> socket.socket:
    peer = socket.create_connection(("127.0.0.1", server.port), 10)
    peer.sendall(data)
    return peer


def upgrade(*extra: str, path: str = "/v1/streams/main/live", protocol: str = "streamlod.v1") -> bytes:
    head = HANDSHAKE.replace("/v1/streams/main/live", path).replace("streamlod.v1", protocol)
    return head.replace("\r\n\r\n", "\r\n" + "".join(f"{line}\r\n" for line in extra) + "\r\n").encode()


def ends_within(peer: socket.socket, seconds: float) -> bool:
    """Whether the server closes; what it says before is read."""
    end = time.monotonic() + seconds
    with peer, contextlib.suppress(ConnectionError):
        while (left := end - time.monotonic()) > 0:
            peer.settimeout(left)
            try:
                if not peer.recv(1 << 16):
                    return True
            except TimeoutError:
                return False
        return False
    return True


@pytest.mark.parametrize(
    "request_bytes",
    [
        upgrade(f"X-Long: {'x' * 9000}"),
        upgrade(*(f"X-{number}: 1" for number in range(140))),
        upgrade(path="/v1/streams/main/" + "live" * 3000),
        upgrade("X-Folded: \x01"),
        upgrade("Content-Length: 5"),
    ],
    ids=["long line", "many lines", "long path", "bad byte", "body"],
)
def test_an_upgrade_that_websockets_refuses_is_answered_and_closed(request_bytes: bytes) -> None:
    with running(Settings(limits=_LIMITS), UNWATCHED) as server:
        peers = [connected(server, request_bytes) for _ in range(5)]
        assert all(ends_within(peer, 3) for peer in peers)
        with server.client() as client:
            assert client.get("/healthz").status_code == 200


def test_a_long_upgrade_header_gets_431() -> None:
    with running(Settings(limits=_LIMITS), UNWATCHED) as server:
        with connected(server, upgrade(f"X-Long: {'x' * 9000}")) as peer:
            assert peer.recv(4096).startswith(b"HTTP/1.1 431 ")
        assert server.registry.turned_away["large"] == 1


@pytest.mark.parametrize(
    ("fields", "status"),
    [
        ([f"X-{number}: 1" for number in range(120)], 200),
        ([f"X-{number}: 1" for number in range(200)], 431),
        ([f"X-{number}: 1" for number in range(700)], 431),
        ([f"X-Long: {'x' * 9000}"], 431),
        ([f"X-{number}: {'x' * 100}" for number in range(100)], 431),
    ],
    ids=["some", "many", "very many", "long", "large"],
)
def test_a_head_is_bounded(fields: list[str], status: int) -> None:
    limits = _LIMITS.model_copy(update={"request_bytes": 8192})  # which one segment holds
    with running(Settings(limits=limits), UNWATCHED) as server:
        head = "\r\n".join(["GET /healthz HTTP/1.1", "Host: localhost", "Connection: close", *fields, "", ""])
        with connected(server, head.encode()) as peer:
            assert peer.recv(4096).startswith(f"HTTP/1.1 {status} ".encode())
        assert server.registry.turned_away["large"] == (status == 431)


def test_fields_behind_a_body_in_chunks_are_bounded() -> None:
    with running(Settings(limits=_LIMITS), UNWATCHED) as server:
        head = b"POST /v1/streams HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n"
        with connected(server, head + b"".join(b"X-%d: 1\r\n" % number for number in range(1000)) + b"\r\n") as peer:
            assert ends_within(peer, 10)
        assert server.registry.turned_away["large"] == 1


def partial(chooser: random.Random) -> bytes:
    """The beginning of something that a client may send, damaged now and then."""
    whole = chooser.choice(
        [
            b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
            b"GET /v1/streams HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n",
            b"POST /v1/streams HTTP/1.1\r\nHost: localhost\r\nContent-Length: 500\r\n\r\n{",
            b"POST /v1/streams HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nabc",
            b"CONNECT x:1 HTTP/1.1\r\nHost: localhost\r\n\r\n",
            b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\n\r\n",
            b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\nGET /hea",
            b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
            upgrade(),
            upgrade() + masked(1, b'{"type":"hello","versions":[2]}'),
            upgrade() + masked(8, b""),
            upgrade() + b"\x01\x85" + bytes(4) + b"hel",
            upgrade(protocol="nothing"),
            upgrade(path="/v1/streams/none/live"),
            upgrade(path="/v1/streams/main/ingest", protocol="streamlod.push.v1"),
            upgrade(path="/nowhere"),
            upgrade(*(f"X-{number}: {'y' * chooser.randrange(200)}" for number in range(chooser.randrange(200)))),
        ]
    )
    data = bytearray(whole)
    if chooser.random() < 0.5:
        del data[chooser.randrange(len(data)) :]
    if data and chooser.random() < 0.2:
        data[chooser.randrange(len(data))] = chooser.randrange(256)
    return bytes(data)


def none_left(seconds: float, per_second: int, seed: int) -> None:
    """Open random partial connections for so long; none may outlive its deadline, and the server goes on serving."""
    chooser, peers = random.Random(seed), []
    with running(Settings(limits=_LIMITS), UNWATCHED) as server:
        begin = time.monotonic()
        while time.monotonic() < begin + seconds:
            peers.append(connected(server, partial(chooser)))
            time.sleep(1 / per_second)
        end = time.monotonic() + run.KEEP_ALIVE_SECONDS + _OTHER_SECONDS
        left = [peer for peer in peers if not ends_within(peer, max(0.05, end - time.monotonic()))]
        assert not left, f"{len(left)} of {len(peers)} are open"
        with server.client() as client:
            assert client.get("/healthz").status_code == 200


@pytest.mark.long
def test_random_partial_requests_leave_nothing_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "KEEP_ALIVE_SECONDS", 1)
    monkeypatch.setattr(websocket, "CLOSE_SECONDS", 1.0)
    none_left(seconds=2, per_second=150, seed=1)


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_a_minute_of_random_partial_requests_leaves_nothing_open() -> None:
    none_left(seconds=60, per_second=60, seed=2)
