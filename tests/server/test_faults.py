"""Slow, stuck and hostile peers: they cost little, and nobody else notices."""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import socket
import threading
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Self

import pytest
from websockets.exceptions import ConnectionClosed

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.errors import SessionError
from streamlod.core.scene.residual import difference
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.protocol.messages import parse_hello
from streamlod.server.protocol.packets import stream_packet
from streamlod.server.settings import Limits, Settings
from streamlod.server.stream.counters import Counters
from streamlod.server.stream.hub import Hub
from tests.codec.scenes import assert_same_level, assert_same_state, make_scene, move
from tests.server.conftest import UNWATCHED, Clip, make_clip, running, viewing

HANDSHAKE = (
    "GET /v1/streams/main/live HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Protocol: streamlod.v1\r\n\r\n"
)


@pytest.fixture(scope="module")
def heavy(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """A clip with packets large enough to fill socket buffers."""
    return make_clip(tmp_path_factory.mktemp("heavy") / "scene.slod", 150, counts=(50, 500, 4000))


def raw(port: int, receive_bytes: int | None = None) -> socket.socket:
    """A socket after the websocket handshake, with a small receive buffer if wanted."""
    peer = socket.socket()
    if receive_bytes is not None:
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
    peer.settimeout(10)
    peer.connect(("127.0.0.1", port))
    peer.sendall(HANDSHAKE.encode())
    assert b"101" in peer.recv(4096)
    return peer


def masked(opcode: int, data: bytes) -> bytes:
    """A client's websocket frame with a mask of zeros."""
    size = bytes((0x80 | len(data),)) if len(data) < 126 else b"\xfe" + len(data).to_bytes(2, "big")
    return bytes((0x80 | opcode,)) + size + bytes(4) + data


@pytest.mark.long
def test_a_stuck_viewer_is_cut_off_and_others_go_on(heavy: Clip) -> None:
    limits = Limits(stuck_seconds=4.0, viewer_lag_seconds=0.3, viewer_bytes=16384)
    with running(Settings(limits=limits), StreamSpec(play=heavy.path)) as server:
        server.wait(lambda stream: stream["state"] == "live")
        with raw(server.port, 4096) as stuck, viewing(server) as viewer:
            stuck.sendall(masked(1, b'{"type":"hello","versions":[1]}'))
            viewer.hello()
            viewer.until("caught_up")
            counters = server.registry.streams["main"].counters
            limit = time.monotonic() + 60
            while counters.stuck == 0:
                viewer.step()
                assert time.monotonic() < limit
            viewer.next_packet()
            assert server.stream()["viewers"] == 1
            scene = viewer.decoder.scene
            assert scene is not None
            assert viewer.decoder.versions[0] >= 0
            for number, version in enumerate(viewer.decoder.versions):
                if version >= 0:  # a slow machine's viewer may have the coarse levels only
                    assert_same_level(heavy.states[version].levels[number], scene.levels[number])


@pytest.mark.long
def test_a_slow_viewer_skips_and_its_frames_stay_exact(heavy: Clip) -> None:
    limits = Limits(viewer_lag_seconds=0.2)
    with running(Settings(limits=limits), StreamSpec(play=heavy.path, loop=False)) as server:
        server.wait(lambda stream: stream["state"] == "live")
        with viewing(server) as viewer:
            viewer.hello(kilobytes_per_second=200)
            while not viewer.named("skipped"):
                viewer.step()
            last = heavy.states[-1].version
            while not viewer.decoder.versions or viewer.decoder.versions[0] < last:
                viewer.step()
            scene = viewer.decoder.scene
            assert scene is not None
            assert_same_level(heavy.states[-1].levels[0], scene.levels[0])


class Hoarder:
    """A proxy that takes whatever the server gives at once, and passes it on at its own pace."""

    def __init__(self, port: int, bytes_per_second: int) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._server = socket.create_connection(("127.0.0.1", port))
        self._rate, self.held = bytes_per_second, bytearray()
        self._threads = [threading.Thread(target=run) for run in (self._up, self._take, self._pass_on)]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        for peer in (self._server, self._viewer):
            with contextlib.suppress(OSError):
                peer.shutdown(socket.SHUT_RDWR)  # which wakes who reads it
        for peer in (self._server, self._viewer, self._listener):
            peer.close()
        for thread in self._threads:
            thread.join(60)

    def _up(self) -> None:
        self._viewer, _ = self._listener.accept()
        with contextlib.suppress(OSError):
            while data := self._viewer.recv(65536):
                self._server.sendall(data)

    def _take(self) -> None:
        with contextlib.suppress(OSError):
            while data := self._server.recv(1 << 20):
                self.held += data

    def _pass_on(self) -> None:
        with contextlib.suppress(OSError):
            while self._server.fileno() >= 0:
                time.sleep(0.02)
                data = bytes(self.held[: self._rate // 50])
                if data:
                    self._viewer.sendall(data)
                    del self.held[: len(data)]


@pytest.mark.slow
def test_packets_do_not_pile_up_in_a_proxy_on_the_way(heavy: Clip) -> None:
    with running(Settings(limits=Limits(viewer_lag_seconds=0.3)), StreamSpec(play=heavy.path)) as server:
        server.wait(lambda stream: stream["state"] == "live")
        piled, rate = 0, 100_000  # a quarter of the stream
        with Hoarder(server.port, rate) as proxy, viewing(replace(server, port=proxy.port)) as viewer:
            viewer.hello()
            end = time.monotonic() + 25
            while time.monotonic() < end:
                viewer.step(30)
                piled = max(piled, len(proxy.held))
            assert piled < 3_000_000  # of about eight
            assert viewer.named("levels")[0]["reason"] == "congestion"
            scene = viewer.decoder.scene
            assert scene is not None
            assert_same_level(heavy.states[viewer.decoder.versions[0]].levels[0], scene.levels[0])


@pytest.mark.long
def test_connections_that_never_speak_websocket_properly_do_no_harm(clip: Clip) -> None:
    with running(Settings(limits=Limits(hello_seconds=2)), StreamSpec(play=clip.path)) as server:
        server.wait(lambda stream: stream["state"] == "live")
        peers = [raw(server.port) for _ in range(50)]  # no hello
        giant = raw(server.port)
        giant.sendall(b"\x81\xff" + (2**63 - 1).to_bytes(8, "big") + bytes(4))
        unmasked = raw(server.port)
        unmasked.sendall(b"\x81\x02{}")
        reserved = raw(server.port)
        reserved.sendall(masked(3, b""))
        for peer, code in ((giant, 1009), (unmasked, 1002), (reserved, 1002)):
            frame = b""
            while len(frame) < 4 and (more := peer.recv(4096)):
                frame += more
            assert int.from_bytes(frame[2:4], "big") == code
        for peer in peers:
            frame = peer.recv(4096)
            assert int.from_bytes(frame[2:4], "big") == 4408
        with viewing(server) as viewer:
            viewer.hello()
            viewer.until("caught_up")
        for peer in (*peers, giant, unmasked, reserved):
            peer.close()


def test_a_crowd_that_says_hello_at_once_gets_no_more_places_than_there_are() -> None:
    limits = Limits(viewers=2)
    with running(Settings(limits=limits), UNWATCHED) as server, ExitStack() as stack:
        crowd = [stack.enter_context(viewing(server)) for _ in range(4)]
        for viewer in crowd[:2]:
            viewer.hello()
        for viewer in crowd[2:]:
            with pytest.raises(ConnectionClosed, match="the server is full"):
                viewer.hello()


def test_a_websocket_too_many_is_refused() -> None:
    settings = Settings(limits=Limits(connections=3))
    with running(settings, UNWATCHED) as server, ExitStack() as stack:
        for _ in range(2):
            stack.enter_context(raw(server.port))
        with socket.create_connection(("127.0.0.1", server.port), 10) as peer:
            peer.sendall(HANDSHAKE.encode())
            assert peer.recv(4096).startswith(b"HTTP/1.1 503")
        assert server.registry.turned_away["many"] == 1


@pytest.mark.parametrize("client", ["a\nINFO server: all is well", "\x1b[2J", "\ud800"])
def test_a_name_that_would_spoil_the_log_is_refused(client: str) -> None:
    with pytest.raises(SessionError) as refused:
        parse_hello(json.dumps({"type": "hello", "versions": [1], "client": client}))
    assert refused.value.close_code == 4400


def test_a_missing_file_fails_at_once_with_one_sentence(tmp_path: Path) -> None:
    with running(Settings(), StreamSpec(play=tmp_path / "none.slod")) as server:
        found = server.wait(lambda stream: stream["state"] == "failed")
        assert "none.slod" in found["detail"]
        assert found["restarts"] == 0
        with server.client() as client:
            assert client.get("/readyz").status_code == 200  # the others can be watched
            assert client.get("/v1/streams/main/ready").status_code == 503


def test_any_schedule_of_joins_and_skips_decodes_to_the_same_state() -> None:
    async def run(seed: int) -> None:
        chooser, hub = random.Random(seed), Hub(10**7, Counters())
        states = [make_scene((5, 20, 40), seed=seed)]
        hub.send(await hub.decode(stream_packet(0, 1, encode_keyframe(states[0], time_ns=0, profile=0))))
        decoder, sequence = SceneDecoder(), None
        for version in range(1, 25):
            states.append(move(states[-1], seed=version))
            residual = difference(states[-2], states[-1])
            packet = encode_residual(states[-2], residual, time_ns=version, profile=0)
            hub.send(await hub.decode(stream_packet(version, 1, packet)))
            match chooser.choice(["nothing", "join", "next", "skip"]):
                case "join":
                    decoder = SceneDecoder()
                    for part in hub.key_parts(0, 2):
                        decoder.push(part.data)
                    newest, message = await hub.catch_up(0, 2)
                    if message:
                        decoder.push(message.data)
                    sequence = newest.sequence
                case "next" if sequence is not None:
                    following = hub.window.after(sequence)
                    if following is not None:
                        decoder.push(following.message(3).data)
                        sequence = following.sequence
                case "skip" if sequence is not None and sequence < version:
                    newest, message = await hub.skip(sequence, 3)
                    decoder.push(message.data)
                    sequence = newest.sequence
            if sequence is not None:
                assert_same_state(states[sequence], decoder.scene)

    for seed in range(8):
        asyncio.run(run(seed))
