"""Whatever a viewer does, and however badly its link behaves, what it holds is the sequential decode, to the bit."""

from __future__ import annotations

import asyncio
import json
import random
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import streamlod.server.stream.hub
import streamlod.server.stream.stream
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.packet.info import PacketInfo, peek
from streamlod.codec.packet.packet import PacketKind
from streamlod.core.scene.anchors import AnchorLevel, Scene
from streamlod.core.scene.residual import difference
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.protocol.messages import Ack, Hello, Pause, Play, Seek, Set
from streamlod.server.protocol.packets import BinaryMessage, Position
from streamlod.server.settings import Limits, Retention, Settings
from streamlod.server.stream.recording.store import Store
from streamlod.server.stream.worker_stream import WorkerStream
from streamlod.server.viewer.session import ViewerSession
from streamlod.server.worker.messages import Tag
from tests.codec.scenes import grow, make_scene, move

LIMITS = Limits(viewer_lag_seconds=0.01, messages_per_second=1e6, flight_bytes=65536)
FRAMES, KEY_EVERY, EPOCHS, VIEWERS = 24, 9, 2, 25


def epoch_of(scene: Scene) -> int:
    """The test's scenes carry their epoch as frame rate."""
    return round(scene.header.fps)


class Clip:
    """Two encoder runs with keyframes, growth and motion; `states` by (epoch, version)."""

    def __init__(self, seed: int) -> None:
        self.packets: list[list[bytes]] = []
        self.states: dict[tuple[int, int], Scene] = {}
        for epoch in range(1, EPOCHS + 1):
            self.packets.append(self._run(seed, epoch))

    def _run(self, seed: int, epoch: int) -> list[bytes]:
        packets: list[bytes] = []
        for version in range(FRAMES):
            if version % KEY_EVERY == 0:
                fresh = make_scene((3, 10, 20), seed=seed + 10 * epoch + version)
                header = replace(fresh.header, fps=float(epoch))
                scene = Scene(header, fresh.weights, fresh.levels, version, version)
                packets.append(encode_keyframe(scene, time_ns=version * 4_000_000, profile=0))
            else:
                before, scene = scene, (grow if version % 5 == 2 else move)(scene, seed=version)
                residual, time_ns = difference(before, scene), version * 4_000_000
                packets.append(encode_residual(before, residual, time_ns=time_ns, profile=0))
            self.states[epoch, version] = scene
        return packets

    def check(self, decoder: SceneDecoder) -> None:
        """Every level that the decoder has equals the sequential decode at that level's version."""
        scene = decoder.scene
        assert scene is not None
        for number, version in enumerate(decoder.versions):
            if version >= 0:
                expected = self.states[epoch_of(scene), version].levels[number]
                for name in AnchorLevel.__slots__:
                    assert np.array_equal(getattr(expected, name), getattr(scene.levels[number], name)), (version, name)


class Link:
    """A viewer's end: decodes what arrives; nothing arrives while it is stalled.

    While it follows the live edge, versions that do not come one by one have to be told.
    """

    def __init__(self, clip: Clip) -> None:
        self.clip, self.decoder, self.received = clip, SceneDecoder(), 0
        self.open = asyncio.Event()
        self.open.set()
        self.events: list[dict[str, Any]] = []
        self._last, self._live, self._told = -1, False, True

    async def binary(self, message: BinaryMessage, interval_seconds: float | None = None) -> None:
        await self.open.wait()
        self._take(message.frame)

    async def text(self, message: str) -> None:
        await self.open.wait()
        said = json.loads(message)
        self.events.append(said)
        self._told = self._told or said.get("event") in {"skipped", "levels", "epoch", "position"}
        if said.get("event") == "position":
            self._live = said["mode"] == "live"

    def post(self, frame: bytes) -> None:
        assert self.is_clear
        self._take(frame)

    @property
    def is_clear(self) -> bool:
        return self.open.is_set()

    def on_blocked(self, call: Callable[[], None]) -> None:
        self._blocked = call

    def stall(self) -> None:
        self.open.clear()
        self._blocked()

    def _take(self, frame: bytes) -> None:
        short = frame[1]
        head = 2 if short < 126 else 4 if short == 126 else 10
        end = head + (short if head == 2 else int.from_bytes(frame[2:head], "big"))
        packet = frame[head:end]
        if frame[end:]:  # a window event that travels with the packet
            self.events.append(json.loads(frame[end + (2 if frame[end + 1] < 126 else 4) :]))
        self._count(peek(packet))
        self.decoder.push(packet)
        self.received += len(packet)
        self.clip.check(self.decoder)

    def _count(self, info: PacketInfo) -> None:
        follows = info.to_version in {self._last, self._last + 1}
        assert follows or self._told or not self._live, f"{self._last} to {info.to_version}: {self.events[-5:]}"
        self._last = info.to_version
        self._told = self._told and info.kind is PacketKind.KEY  # a residual over what was told may follow that


class Schedule:
    """One viewer doing random things."""

    def __init__(self, stream: WorkerStream, clip: Clip, seed: int) -> None:
        self._stream, self._clip, self._chooser = stream, clip, random.Random(seed)
        self._connect()

    def _connect(self) -> None:
        chooser = self._chooser
        start = self._place() if chooser.random() < 0.3 else None
        hello = Hello("schedule", start, chooser.choice([None, None, 1, 2, 3]), None)
        self._link = Link(self._clip)
        self._session = ViewerSession(self._stream, hello, self._link, LIMITS)
        self._task = asyncio.create_task(self._session.run())

    async def _disconnect(self) -> None:
        self._task.cancel()
        with suppress(asyncio.CancelledError):
            await self._task

    def _place(self) -> Position:
        return Position(self._chooser.randrange(EPOCHS + 2), self._chooser.randrange(FRAMES + 5))

    async def run(self, steps: int) -> None:
        """Do things while packets come."""
        for _ in range(steps):
            await asyncio.sleep(self._chooser.random() * 0.02)
            await self._act()
        self._link.open.set()

    async def _act(self) -> None:
        chooser, session, link = self._chooser, self._session, self._link
        match chooser.choice(
            ["wait", "stall", "resume", "seek", "live", "pause", "play", "levels", "cap", "ack", "again"]
        ):
            case "stall":
                link.stall()
            case "resume" | "wait":
                link.open.set()
            case "seek":
                session.on_control(Seek(self._place()))
            case "live":
                session.on_control(Seek(None))
            case "pause":
                session.on_control(Pause())
            case "play":
                session.on_control(Play())
            case "levels":
                session.on_control(Set(chooser.choice([None, 1, 2, 3]), None, frozenset({"levels"})))
            case "cap":
                session.on_control(Set(None, chooser.choice([None, 50.0, 5000.0]), frozenset({"kilobytes_per_second"})))
            case "ack":
                session.on_control(Ack(link.received))
            case "again":
                await self._disconnect()
                self._connect()

    async def settle(self) -> Scene | None:
        """Ask for everything, live; what the viewer holds in the end."""
        session, link = self._session, self._link
        link.open.set()
        session.on_control(Set(None, None, frozenset({"levels", "kilobytes_per_second"})))
        session.on_control(Ack(link.received))
        session.on_control(Seek(None))
        newest = self._stream.newest
        async with asyncio.timeout(60):
            while not self._task.done():
                scene, versions = link.decoder.scene, link.decoder.versions
                assert newest is not None
                if scene is not None and epoch_of(scene) == newest.epoch and set(versions) == {newest.version}:
                    break
                await asyncio.sleep(0.005)
                session.on_control(Ack(link.received))
        if self._task.done():
            self._task.result()
        await self._disconnect()
        return link.decoder.scene


async def play(folder: Path | None, seed: int, viewers: int) -> None:
    """A stream of two epochs watched by `viewers` schedules."""
    clip = Clip(seed)
    retention = Retention.model_construct(**{**Retention().model_dump(), "memory_bytes": 6000})
    settings = Settings(limits=LIMITS).model_copy(update={"retention": retention})
    store = Store(folder, retention) if folder else None
    stream = WorkerStream(StreamSpec(play=Path("fed by hand")), settings, store.recording("main") if store else None)
    schedules: list[Schedule] = []
    tasks: list[asyncio.Task[None]] = []
    for epoch, packets in enumerate(clip.packets):
        if epoch:
            await stream.work.on_message(Tag.EPOCH, b"")
        for number, data in enumerate(packets):
            await stream.work.on_message(Tag.PACKET, data)
            if number % 2 == 0 and len(schedules) < viewers:
                for _ in range(viewers // 12 + 1):
                    schedules.append(Schedule(stream, clip, seed * 1000 + len(schedules)))
                    tasks.append(asyncio.create_task(schedules[-1].run(12)))
            await asyncio.sleep(0.004)
    await asyncio.gather(*tasks)
    assert len(schedules) >= viewers
    assert stream.counters.skips
    newest = clip.states[EPOCHS, FRAMES - 1]
    for scene in await asyncio.gather(*(schedule.settle() for schedule in schedules)):
        assert scene is not None
        assert (scene.version, epoch_of(scene)) == (newest.version, EPOCHS)
    assert stream.viewers == 0
    assert not stream.hub.listeners
    if store:
        store.close()


def run_schedules(folder: Path, monkeypatch: pytest.MonkeyPatch, rounds: int) -> None:
    monkeypatch.setattr(
        streamlod.server.stream.stream, "_HUB_BYTES", 4000
    )  # so that viewers fall out of the hub's window
    monkeypatch.setattr(
        streamlod.server.stream.hub, "_STATE_BYTES", 30_000
    )  # and out of the states that one residual can start from
    for seed in range(rounds):
        asyncio.run(play(folder / str(seed) if seed % 2 else None, seed, VIEWERS))


@pytest.mark.long
def test_a_hundred_random_schedules_decode_to_the_same_states(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_schedules(tmp_path, monkeypatch, 4)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_thousand_random_schedules_decode_to_the_same_states(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_schedules(tmp_path, monkeypatch, 40)
