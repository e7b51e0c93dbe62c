"""A small server of the viewer protocol, for tests of the page: a fixed list of states, and faults on request."""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI, Response, WebSocket, WebSocketDisconnect
from fastapi.staticfiles import StaticFiles
from PIL import Image
from starlette.types import ASGIApp

from streamlod.codec.container import SlodWriter
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.residual import difference
from streamlod.server.http.static_page import PageFiles
from tests.client.web.scenes import moved

WEB = Path(__file__).parents[3] / "client" / "web"


@dataclass
class Clip:
    """States of one stream, filmed `frame_ns` apart, and their packets, which are made on demand between any two.

    Every second one is filmed `late_ns` later than that.
    """

    states: list[Scene]
    profile: int = 1
    frame_ns: int = 33_333_333
    late_ns: int = 0
    _made: dict[tuple[int, int], bytes] = field(default_factory=dict)

    def key(self) -> bytes:
        """The keyframe."""
        return encode_keyframe(self.states[0], time_ns=0, profile=self.profile)

    def residual(self, before: int, after: int) -> bytes:
        """From one state to a later one."""
        if (before, after) not in self._made:
            change = difference(self.states[before], self.states[after])
            time_ns = after * self.frame_ns + after % 2 * self.late_ns
            packet = encode_residual(self.states[before], change, time_ns=time_ns, profile=self.profile)
            self._made[before, after] = packet
        return self._made[before, after]

    def write(self, path: Path) -> None:
        """As a `.slod` file: the keyframe, and each state from the one before."""
        with SlodWriter(path) as writer:
            writer.append(self.key())
            for version in range(1, len(self.states)):
                writer.append(self.residual(version - 1, version))


def make_clip(scene: Scene, frames: int, profile: int = 1, frame_ns: int = 33_333_333) -> Clip:
    """A clip that begins with `scene`."""
    states = [scene]
    for _ in range(frames - 1):
        states.append(moved(states[-1]))
    return Clip(states, profile, frame_ns)


@dataclass
class Behaviour:
    """What the server does; tests change it while it runs."""

    fps: float = 20.0
    version: int = 1
    state: str = "live"
    detail: str = ""
    close: tuple[int, str] | None = None
    progress: tuple[float, str] | None = None  # in the welcome
    preview: bool = False  # a stream that starts has pictures already
    source: str = "cameras"
    leave: tuple[int, str] | None = None  # close every connection, once set
    lead_ns: int = 0  # how far the server's clock is ahead of the times in the packets
    newest: int | None = None  # the live edge stops there
    corrupt: set[int] = field(default_factory=set)  # versions whose packet is damaged, once
    streams: tuple[str, ...] = ("main",)
    viewers: int = 1  # in the list of streams
    camera_pictures: dict[str, bytes] = field(default_factory=dict)
    hellos: list[dict[str, Any]] = field(default_factory=list)
    wishes: list[dict[str, Any]] = field(default_factory=list)  # heard, not obeyed


def newest_of(clip: Clip, behaviour: Behaviour, started: float) -> int:
    """The newest version of a stream that began at monotonic time `started`."""
    last = len(clip.states) - 1
    limit = last if behaviour.newest is None else min(last, behaviour.newest)
    return min(limit, int((time.monotonic() - started) * behaviour.fps) + 1)


class Viewer:
    """One connection."""

    def __init__(self, socket: WebSocket, clip: Clip, behaviour: Behaviour, started: float) -> None:
        self.socket, self.clip, self.behaviour, self.started = socket, clip, behaviour, started
        self.mode, self.version, self.have = "live", -1, -1
        self.turn = asyncio.Lock()  # nothing comes between the answer to a seek and its keyframe

    @property
    def edge(self) -> int:
        """The newest version there is."""
        return newest_of(self.clip, self.behaviour, self.started)

    def position(self, version: int) -> dict[str, int]:
        """As the protocol writes it."""
        return {"epoch": 1, "version": version}

    def window(self) -> dict[str, Any]:
        """What can be sought."""
        edge = self.edge
        filmed = {"newest_time_ns": edge * self.clip.frame_ns}
        return {"oldest": self.position(0), "newest": self.position(edge), **filmed}

    async def event(self, name: str, **fields: Any) -> None:
        """Send an event."""
        await self.socket.send_text(json.dumps({"type": "event", "event": name, **fields}))

    async def run(self) -> None:
        """Say welcome, then serve until the connection ends."""
        b = self.behaviour
        hello = json.loads(await self.socket.receive_text())
        b.hellos.append(hello)
        if b.close:
            await self.socket.close(*b.close)
            return
        ready = b.preview or b.state not in ("idle", "starting")
        facts: dict[str, Any] = {"levels": 3, "fps": b.fps, "window": self.window()} if ready else {}
        progress = b.progress and {"fraction": b.progress[0], "loss": None, "text": b.progress[1]}
        welcome = {"type": "welcome", "version": b.version, "session": "test", "stream": "main", "state": b.state}
        welcome |= {"detail": b.detail, "epoch": 1, "levels": None, "fps": None, "window": None, "ack_every": 8}
        welcome |= {"source": b.source, "loop": False, "progress": progress}
        welcome |= {"server_time_ns": int((time.monotonic() - self.started) * 1e9) + b.lead_ns}
        await self.socket.send_text(json.dumps(welcome | facts))
        if ready:
            start = hello["start"]
            await self.jump(self.edge if start == "live" else start["version"], "live" if start == "live" else "replay")
            sender = asyncio.create_task(self.send_frames())
        else:
            sender = asyncio.create_task(asyncio.sleep(3600))
        try:
            await self.listen()
        finally:
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sender

    async def jump(self, version: int, mode: str) -> None:
        """Keyframe and catch-up to a version."""
        version = max(0, min(version, self.edge))
        async with self.turn:
            self.mode, self.version = mode, version
            await self.event("position", mode=mode, **self.position(version), clamped=False)
            await self.socket.send_bytes(self.clip.key())
            if version:
                await self.socket.send_bytes(self.clip.residual(0, version))
            if mode == "live":
                await self.event("caught_up")

    async def send_frames(self) -> None:
        """Frame after frame at the clip's rate."""
        said = 0.0
        while True:
            await asyncio.sleep(1 / self.behaviour.fps)
            if self.behaviour.leave:
                await self.socket.close(*self.behaviour.leave)
                return
            if time.monotonic() - said > 0.5:
                said = time.monotonic()
                await self.event("window", **self.window())
            async with self.turn:
                await self.send_next()

    async def send_next(self) -> None:
        """The next frame, if there is one."""
        if self.mode == "paused" or self.version >= self.edge:
            return
        target = self.edge if self.mode == "live" else self.version + 1
        packet = self.clip.residual(self.version, target)
        if target in self.behaviour.corrupt:
            self.behaviour.corrupt.discard(target)
            packet = packet[:-3] + bytes([packet[-3] ^ 0x55]) + packet[-2:]
        self.version = target
        await self.socket.send_bytes(packet)
        if self.mode == "replay" and target == self.edge:
            self.mode = "live"
            await self.event("caught_up")

    async def listen(self) -> None:
        """Obey control messages."""
        while True:
            message = json.loads(await self.socket.receive_text())
            if message["type"] == "seek":
                live = message["to"] == "live"
                await self.jump(self.edge if live else message["to"]["version"], "live" if live else "replay")
            elif message["type"] == "set":
                self.behaviour.wishes.append(message)
            elif message["type"] in ("pause", "play"):
                self.mode = "paused" if message["type"] == "pause" else "replay"
                await self.event("position", mode=self.mode, **self.position(self.version), clamped=False)


def create_app(clip: Clip, behaviour: Behaviour, files: Path | None = None, page: Path = WEB) -> FastAPI:
    """The page, the live socket, the list of streams and, where given, a folder of files under /files."""
    app = FastAPI()
    started = time.monotonic()

    @app.websocket("/v1/streams/{stream}/live")
    async def live(socket: WebSocket, stream: str) -> None:
        await socket.accept(subprotocol="streamlod.v1")
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await Viewer(socket, clip, behaviour, started).run()

    @app.get("/v1/streams")
    def streams() -> dict[str, Any]:
        items = [
            {"id": s, "name": s, "state": behaviour.state, "viewers": behaviour.viewers,
             "camera_pictures": list(behaviour.camera_pictures)}
            for s in (() if behaviour.close or behaviour.leave else behaviour.streams)
        ]  # fmt: skip
        return {"items": items, "next_cursor": None}

    @app.get("/v1/streams/{stream}/manifest")
    def manifest(stream: str) -> dict[str, Any]:
        edge = newest_of(clip, behaviour, started)
        group = {"epoch": 1, "first": 0, "last": edge, "first_time_ns": 0, "last_time_ns": edge * clip.frame_ns}
        return {"stream": stream, "gops": [group]}

    @app.get("/v1/streams/{stream}/poster.jpg")
    def poster(stream: str) -> Response:
        file = io.BytesIO()
        Image.linear_gradient("L").resize((160, 90)).convert("RGB").save(file, "JPEG")
        return Response(file.getvalue(), media_type="image/jpeg")

    @app.get("/v1/streams/{stream}/cameras/{camera}.jpg")
    def camera_picture(stream: str, camera: str) -> Response:
        jpeg = behaviour.camera_pictures.get(camera)
        return Response(jpeg, media_type="image/jpeg") if jpeg else Response(status_code=404)

    if files is not None:
        app.mount("/files", StaticFiles(directory=files))
    app.mount("/", PageFiles(directory=page, html=True))
    return app


@contextlib.contextmanager
def serving(app: ASGIApp, port: int = 0) -> Iterator[str]:
    """Serve in a thread, at a free port by default; yields the address."""
    config = uvicorn.Config(
        app,
        log_level="error",
        ws="websockets-sansio",
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
    )
    server = uvicorn.Server(config)
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", port))
        thread = threading.Thread(target=server.run, args=([listener],), daemon=True)
        thread.start()
        try:
            limit = time.monotonic() + 60
            while not server.started:
                assert thread.is_alive()
                assert time.monotonic() < limit
                time.sleep(0.02)
            yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            server.should_exit = True
            thread.join(60)
            assert not thread.is_alive()
