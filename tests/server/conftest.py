"""A real server on loopback, fed from recorded files that the codec wrote."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import httpx
import pytest
from websockets.sync.client import ClientConnection, connect

from streamlod.codec.container import SlodWriter
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.mp4.sound import SoundPiece, is_piece, read_piece
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.residual import difference
from streamlod.server.api.registry import Registry
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.protocol.packets import PacketWindow, Position
from streamlod.server.service.app import create_app
from streamlod.server.service.run import Server, certificates_of, server_config
from streamlod.server.settings import Settings
from streamlod.server.stream.worker_stream import WorkerStream
from tests.codec.scenes import make_scene, move
from tests.waiting import PATIENCE

FRAME_NS = 20_000_000
UNWATCHED = StreamSpec(play=Path("nothing.slod"), on_demand=True)  # it starts no process before somebody watches


@dataclass(frozen=True, slots=True)
class Clip:
    """A recorded file and the states that it holds."""

    path: Path
    states: list[Scene]
    packets: list[bytes]


def make_clip(
    path: Path,
    frames: int,
    counts: tuple[int, ...] = (10, 40, 120),
    key_every: int = 10**9,
    frame_ns: int = FRAME_NS,
) -> Clip:
    """A clip of moving anchors, a keyframe every `key_every` frames."""
    state, states, packets = make_scene(counts), [], []
    for version in range(frames):
        if version % key_every == 0:
            state = _as_keyframe(make_scene(counts, seed=version), version)
            packets.append(encode_keyframe(state, time_ns=version * frame_ns, profile=0))
        else:
            before, state = state, move(state, seed=version)
            residual = difference(before, state)
            packets.append(encode_residual(before, residual, time_ns=version * frame_ns, profile=0))
        states.append(state)
    with SlodWriter(path) as writer:
        for packet in packets:
            writer.append(packet)
    return Clip(path, states, packets)


def kept_from(window: PacketWindow, first: Position) -> PacketWindow:
    """The same window after memory has forgotten the groups of pictures before `first`."""
    kept = PacketWindow(10**9)
    for group in window.groups():
        for packet in group if group[-1].position >= first else ():
            kept.append(packet)
    return kept


def _as_keyframe(scene: Scene, version: int) -> Scene:
    return Scene(scene.header, scene.weights, scene.levels, version, version)


@dataclass(frozen=True, slots=True)
class Running:
    """A server in a thread."""

    registry: Registry
    port: int
    loop: asyncio.AbstractEventLoop

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def client(self, **options: Any) -> httpx.Client:
        options = {
            "verify": False,
            "timeout": 30,
            **options,
        }  # there is no TLS, and loading authorities takes 20 ms for each client
        return httpx.Client(base_url=self.url, trust_env=False, **options)

    def stream(self, name: str = "main") -> dict[str, Any]:
        with self.client() as client:
            return client.get(f"/v1/streams/{name}").json()  # type: ignore[no-any-return]

    def worker_stream(self, name: str = "main") -> WorkerStream:
        stream = self.registry.streams[name]
        assert isinstance(stream, WorkerStream)
        return stream

    def wait(
        self, done: Callable[[dict[str, Any]], bool], name: str = "main", seconds: float = PATIENCE
    ) -> dict[str, Any]:
        limit = time.monotonic() + seconds
        with self.client() as client:  # one for all looks: a connection for each would take more than half the time
            while not done(found := client.get(f"/v1/streams/{name}").json()):
                assert time.monotonic() < limit, found
                time.sleep(0.02)
        return found  # type: ignore[no-any-return]


@contextmanager
def running(settings: Settings, *specs: StreamSpec, port: int = 0, confined: bool = False) -> Iterator[Running]:
    """A server on a port of loopback, a free one by default; unless `confined`, its streams may read all files."""
    if not confined:
        settings = settings.model_copy(update={"roots": (Path("/"),)})
    app = create_app(settings, specs)
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind(("127.0.0.1", port))
    listener.listen(256)
    server = Server(server_config(app, settings), app.state.registry, certificates_of(settings))
    loops: list[asyncio.AbstractEventLoop] = []

    async def serve() -> None:
        loops.append(asyncio.get_running_loop())
        await server.serve(sockets=[listener])

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    try:
        limit = time.monotonic() + 60
        while not server.started:
            assert time.monotonic() < limit
            assert thread.is_alive()
            time.sleep(0.01)
        yield Running(app.state.registry, listener.getsockname()[1], loops[0])
    finally:
        server.should_exit = True
        thread.join(60)
        listener.close()
        assert not thread.is_alive()


class Viewer:
    """A minimal viewer of docs/protocol.md that decodes everything and keeps all events."""

    def __init__(self, connection: ClientConnection, acknowledge: bool = True) -> None:
        self.connection, self.acknowledge = connection, acknowledge
        self.decoder = SceneDecoder()
        self.sound: list[SoundPiece] = []
        self.events: list[dict[str, Any]] = []
        self.welcome: dict[str, Any] = {}
        self.received = self.packets = self._acknowledged = 0
        self._acked_at = 0.0
        self.epoch = 0

    def send(self, **message: Any) -> None:
        self.connection.send(json.dumps(message))

    def hello(self, **fields: Any) -> Self:
        self.send(**{"type": "hello", "versions": [1], "client": "test/1"} | fields)
        self.welcome = json.loads(self.connection.recv(60))
        assert self.welcome["type"] == "welcome"
        return self

    def step(self, seconds: float = 60) -> bytes | dict[str, Any]:
        """Take the next message; a packet is decoded."""
        message = self._receive(seconds)
        if isinstance(message, str):
            event: dict[str, Any] = json.loads(message)
            self.events.append(event)
            return event
        if is_piece(message):
            self.sound.append(read_piece(message))
            return message
        self.decoder.push(message)
        self.received += len(message)
        self.packets += 1
        if self.packets - self._acknowledged >= self.welcome["ack_every"] or time.monotonic() - self._acked_at > 0.9:
            self._acknowledge()
        return message

    def _receive(self, seconds: float) -> bytes | str:
        """The next message; while there is none, what came is acknowledged within a second."""
        limit = time.monotonic() + seconds
        while True:
            left = limit - time.monotonic()
            try:
                return self.connection.recv(min(left, 0.5))
            except TimeoutError:
                if left <= 0.5:
                    raise
                if self.packets > self._acknowledged:
                    self._acknowledge()

    def _acknowledge(self) -> None:
        self._acknowledged, self._acked_at = self.packets, time.monotonic()
        if self.acknowledge:
            self.send(type="ack", bytes=self.received, epoch=1, version=0)

    def until(self, name: str, seconds: float = 60) -> dict[str, Any]:
        """Step to the next event of that name."""
        while True:
            message = self.step(seconds)
            if isinstance(message, dict) and message["event"] == name:
                return message

    def next_packet(self) -> None:
        """Step to the next packet."""
        while not isinstance(self.step(), bytes):
            pass

    def until_version(self, version: int) -> Scene:
        """Step until all levels are at one version, of at least `version`: while viewers lag, fine levels wait."""
        while len(set(self.decoder.versions)) != 1 or self.decoder.versions[0] < version:
            self.step()
        assert self.decoder.scene is not None
        return self.decoder.scene

    def until_heard(self, time_ns: int) -> None:
        """Step until there is sound up to a time."""
        while not self.sound or self.sound[-1].end_ns < time_ns:
            self.step()

    def named(self, name: str) -> list[dict[str, Any]]:
        return [event for event in self.events if event["event"] == name]


@contextmanager
def viewing(server: Running, name: str = "main", *, acknowledge: bool = True, **options: Any) -> Iterator[Viewer]:
    """A connected viewer that has not said hello yet."""
    address = f"ws://127.0.0.1:{server.port}/v1/streams/{name}/live"
    options = {"subprotocols": ["streamlod.v1"], "compression": None, "max_size": 2**24, "proxy": None, **options}
    # with more messages waiting than it queues, a client reads no further and never sees the answer to its goodbye
    with connect(address, close_timeout=0.3, **options) as connection:
        yield Viewer(connection, acknowledge)


@pytest.fixture(scope="session")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """Two seconds at 50 frames a second with two keyframes."""
    return make_clip(tmp_path_factory.mktemp("clip") / "scene.slod", 100, key_every=60)


@pytest.fixture(scope="session")
def slow_clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """The same at 10 frames a second, for tests that must not see it end or begin again."""
    return make_clip(tmp_path_factory.mktemp("clip") / "slow.slod", 100, key_every=60, frame_ns=100_000_000)
