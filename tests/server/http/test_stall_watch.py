"""Peers that send and take nothing: they neither fill memory nor hold a connection for good."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from streamlod.codec.container import SlodWriter
from streamlod.codec.encoder import encode_keyframe
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Limits, Settings
from tests.codec.scenes import make_scene
from tests.server.conftest import UNWATCHED, Running, running
from tests.server.test_faults import masked, raw
from tests.waiting import wait

_PINGS = masked(9, bytes(125)) * 1000


@contextmanager
def peer_of(server: Running, *, upgraded: bool) -> Iterator[socket.socket]:
    """A connection with a small receive buffer, as a websocket or before that."""
    with raw(server.port, 4096) if upgraded else socket.socket() as peer:
        if not upgraded:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            peer.settimeout(10)
            peer.connect(("127.0.0.1", server.port))
        yield peer


def until_away(server: Running, reason: str) -> None:
    wait(lambda: server.registry.turned_away[reason] == 1)


def test_answers_to_pings_do_not_pile_up() -> None:
    limits = Limits(hello_seconds=60)  # the pings come before the hello
    with running(Settings(limits=limits), UNWATCHED) as server, raw(server.port, 4096) as peer:
        for _ in range(30):
            peer.sendall(_PINGS)
        peer.sendall(masked(1, b'{"type":"goodbye"}'))
        until_away(server, "4400")  # and all pings were taken before
        answers = b""
        while b"the first message must be a hello" not in answers:
            answers += peer.recv(1 << 20)
        assert len(answers) < len(_PINGS) * 30 / 4


def test_a_message_in_endless_parts_is_refused() -> None:
    with running(Settings(), UNWATCHED) as server, raw(server.port) as peer:
        peer.sendall(b"\x01\x80" + bytes(4) + (b"\x00\x80" + bytes(4)) * 2000)
        frame = peer.recv(4096)
        assert frame[0] == 0x88
        assert int.from_bytes(frame[2:4], "big") == 1008
        assert server.registry.turned_away["1008"] == 1


@pytest.mark.parametrize("upgraded", [False, True])
def test_a_peer_that_takes_no_answer_is_cut(upgraded: bool) -> None:
    settings = Settings(limits=Limits(stuck_seconds=0.3, hello_seconds=0.2))
    with running(settings, UNWATCHED) as server, peer_of(server, upgraded=upgraded) as peer:
        request = _PINGS * 10 if upgraded else b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n" * 120
        with contextlib.suppress(ConnectionError):
            peer.sendall(request)
        until_away(server, "stalled")
        with contextlib.suppress(ConnectionError):
            while peer.recv(1 << 20):  # what the kernel had; then it ends
                pass


@pytest.mark.long
def test_a_download_that_is_read_too_slowly_is_cut_and_a_slow_one_is_not(tmp_path: Path) -> None:
    large, packet = tmp_path / "large.slod", encode_keyframe(make_scene((50, 500, 4000)), time_ns=0, profile=0)
    with SlodWriter(large) as writer:
        for _ in range(20_000_000 // len(packet)):  # more than socket buffers take
            writer.append(packet)
    request = b"GET /v1/streams/main/recording HTTP/1.1\r\nHost: localhost\r\n\r\n"
    limits = Limits(stuck_seconds=0.5, download_bytes_per_second=50_000)
    with running(Settings(limits=limits), StreamSpec(play=large)) as server:
        for bytes_at_once, cut in ((4096, False), (100, True)):
            with peer_of(server, upgraded=False) as peer:
                peer.sendall(request)
                end = time.monotonic() + (30 if cut else 2)
                with contextlib.suppress(ConnectionError):
                    while time.monotonic() < end and server.registry.turned_away["stalled"] == 0:
                        peer.recv(bytes_at_once)
                        time.sleep(0.005)
            assert server.registry.turned_away["stalled"] == cut, bytes_at_once


def test_requests_that_wait_for_each_other_are_not_piled_up() -> None:
    with running(Settings(), UNWATCHED) as server, peer_of(server, upgraded=False) as peer:
        peer.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n" * 1000)
        answers = b""
        with contextlib.suppress(ConnectionError):
            while more := peer.recv(1 << 20):
                answers += more
        assert b"400 Bad Request" in answers
        assert answers.count(b'"status":"ok"') <= 130
        assert server.registry.turned_away["crowded"] == 1
