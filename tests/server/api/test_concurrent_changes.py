"""Several callers create, start, stop and delete one stream at once: whatever the order, what is left fits together.

Ten minutes of it: `STREAMLOD_FUZZ_EXAMPLES=2000 python -m pytest -m slow tests/server/api/test_concurrent_changes.py`.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import tempfile
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as some

from streamlod.core.errors import InputError, StreamGoneError
from streamlod.server.api.registry import Registry
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from streamlod.server.stream.worker_stream import WorkerStream
from tests.server.conftest import Clip, running

Action = Literal["create", "create idle", "start", "stop", "delete", "erase"]
ACTIONS: tuple[Action, ...] = ("create", "create idle", "start", "stop", "delete", "erase")
SCHEDULES = some.lists(
    some.tuples(some.sampled_from(ACTIONS), some.sampled_from("ab"), some.sampled_from([0, 0, 1, 20])),
    min_size=4,
    max_size=12,
)  # what is done, to which stream, so many milliseconds after the one before
FEW = settings(max_examples=4, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
MANY = settings(FEW, max_examples=int(os.environ.get("STREAMLOD_FUZZ_EXAMPLES", "300")), derandomize=False)


class Callers:
    """Callers of one registry, and what they were told."""

    def __init__(self, registry: Registry, clip: Path) -> None:
        self._registry, self._clip = registry, clip
        self.present = {"a": 0, "b": 0}  # streams created less those deleted, as the callers were told

    async def act(self, action: Action, name: str) -> None:
        """Do it as a request does: the stream is looked up first, and may be gone when its turn comes."""
        registry = self._registry
        stream = registry.streams.get(name)
        try:
            match action:
                case "create" | "create idle":
                    await registry.create(StreamSpec(id=name, play=self._clip), start=action == "create")
                    self.present[name] += 1
                case _ if not isinstance(stream, WorkerStream):
                    return
                case "start":
                    await registry.start_stream(stream)
                case "stop":
                    await registry.stop_stream(stream)
                    assert not stream.is_running or registry.streams[name] is stream
                case "delete" | "erase":
                    await registry.delete(stream, erase=action == "erase")
                    assert not stream.is_running
                    self.present[name] -= 1
        except StreamGoneError:
            assert registry.streams.get(name) is not stream
        except InputError as error:
            assert "the id is taken" in str(error)  # noqa: PT017 - the only one that may come

    def check(self, folder: Path) -> None:
        """What is left fits together, when nobody does anything."""
        for name, count in self.present.items():
            stream = self._registry.streams.get(name)
            assert count == (stream is not None)
            assert name not in self._registry.kept or stream is None
            assert (folder / "streams" / name).exists() == (stream is not None or name in self._registry.kept)
            if isinstance(stream, WorkerStream):
                assert not stream.deleted
                assert stream.bus.recording is not None
                assert stream.bus.recording.stored.definition is not None
            assert len(workers(name)) == (isinstance(stream, WorkerStream) and stream.worker_pid is not None
                                          and stream.is_running)  # fmt: skip


def workers(name: str) -> list[int | None]:
    """Processes of a stream of that id."""
    return [child.pid for child in multiprocessing.active_children() if child.name == f"streamlod-{name}"]


async def play(schedule: list[tuple[Action, str, int]], clip: Path, folder: Path) -> None:
    registry = Registry(Settings(state=folder, roots=(Path("/"),)))
    registry.start()
    callers, tasks = Callers(registry, clip), []
    for action, name, milliseconds in schedule:
        await asyncio.sleep(milliseconds / 1000)
        tasks.append(asyncio.create_task(callers.act(action, name)))
    await asyncio.gather(*tasks)
    await asyncio.sleep(0)  # what was started last begins its worker
    callers.check(folder)
    await registry.drain()
    assert workers("a") == workers("b") == []


def run(schedule: list[tuple[Action, str, int]], clip: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        asyncio.run(asyncio.wait_for(play(schedule, clip, Path(folder)), 90))


@FEW
@given(schedule=SCHEDULES)
def test_any_order_of_callers_leaves_what_fits_together(clip: Clip, schedule: list[tuple[Action, str, int]]) -> None:
    run(schedule, clip.path)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@MANY
@given(schedule=SCHEDULES)
def test_many_orders_of_callers(clip: Clip, schedule: list[tuple[Action, str, int]]) -> None:
    run(schedule, clip.path)


@pytest.mark.parametrize("erase", [False, True])
def test_a_late_delete_does_not_take_the_stream_that_came_after(clip: Clip, tmp_path: Path, erase: bool) -> None:
    async def late() -> None:
        registry = Registry(Settings(state=tmp_path / "state", roots=(Path("/"),)))
        registry.start()
        old = await registry.create(StreamSpec(id="x", play=clip.path))
        first = asyncio.create_task(registry.delete(old, erase=erase))
        await asyncio.sleep(0)
        new = await registry.create(StreamSpec(id="x", play=clip.path))
        with pytest.raises(StreamGoneError):
            await registry.delete(old, erase=erase)
        await first
        assert registry.streams["x"] is new
        assert (tmp_path / "state" / "streams" / "x").exists()
        assert not new.deleted
        await registry.drain()

    asyncio.run(late())


def test_two_that_start_and_stop_at_once_leave_no_worker_behind(clip: Clip, tmp_path: Path) -> None:
    async def both() -> None:
        registry = Registry(Settings(state=tmp_path / "state", roots=(Path("/"),)))
        registry.start()
        stream = await registry.create(StreamSpec(id="y", play=clip.path), start=True)
        await asyncio.sleep(0)
        calls = [registry.stop_stream, registry.start_stream, registry.stop_stream, registry.start_stream]
        await asyncio.gather(*(call(stream) for call in [*calls, registry.stop_stream]))
        assert not stream.is_running
        assert workers("y") == []
        await registry.drain()

    asyncio.run(both())


def test_a_stream_that_was_deleted_meanwhile_is_not_found(clip: Clip) -> None:
    with running(Settings()) as server, server.client() as client:
        assert client.post("/v1/streams", json={"id": "z", "play": str(clip.path)}).status_code == 201
        assert client.delete("/v1/streams/z").status_code == 204
        for path in ("z/start", "z/stop"):
            assert client.post(f"/v1/streams/{path}").status_code == 404
        assert client.delete("/v1/streams/z").status_code == 404
