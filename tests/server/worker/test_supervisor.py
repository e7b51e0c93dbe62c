"""A worker that hangs, grows, sends rubbish or has gone, and its supervisor."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe
from streamlod.core.errors import InputError
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec, spec_from_json
from streamlod.server.settings import Settings, WorkerSettings
from streamlod.server.stream.worker_stream import WorkerStream
from streamlod.server.worker.cluster.room import Shortage
from streamlod.server.worker.messages import Resume, Sender, Tag, receive_resume
from streamlod.server.worker.supervisor import Ending, Supervisor
from tests.codec.scenes import make_scene
from tests.server.conftest import Clip, running


@pytest.mark.long
def test_a_worker_that_hangs_or_takes_too_much_memory_is_replaced(clip: Clip) -> None:
    settings = Settings.model_validate({"worker": {"heartbeat_seconds": 2.5}})
    with running(settings, StreamSpec(play=clip.path)) as server:
        server.wait(lambda stream: stream["state"] == "live")
        pid = server.worker_stream().worker_pid
        assert pid is not None
        os.kill(pid, signal.SIGSTOP)
        found = server.wait(lambda stream: stream["restarts"] >= 1)
        assert "silent" in found["detail"]
        server.wait(lambda stream: stream["state"] == "live")
        pids = {pid, server.worker_stream().worker_pid}
        with server.client() as client:
            client.post("/v1/streams/main/stop")
        assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]  # not even for their parent to look at
    settings = Settings.model_validate({"worker": {"memory_bytes": 1_000_000, "attempts": 1}})
    with running(settings, StreamSpec(play=clip.path)) as server:
        found = server.wait(lambda stream: stream["restarts"] >= 1)
        assert "memory" in found["detail"] or found["state"] == "starting"


class Reports:
    """Owns a supervisor and keeps what it hears."""

    waits_for_room = False

    def __init__(self) -> None:
        self.tags: list[Tag] = []
        self.endings: list[Ending] = []

    async def on_message(self, tag: Tag, body: bytes) -> None:
        self.tags.append(tag)

    async def resume_point(self) -> Resume:
        return Resume()

    def on_restart(self, ending: Ending, delay_seconds: float) -> None:
        self.endings.append(ending)

    def on_finish(self, ending: Ending) -> None:
        self.endings.append(ending)


def grow_elsewhere(_: StreamSpec, pipe: Connection, *__: object) -> None:
    """Entry of a process whose worker is on another machine, and large."""
    receive_resume(pipe)
    sender = Sender(pipe)
    sender.send(Tag.PLACED, {"node": "far"})
    sender.send(Tag.HEARTBEAT, (10**12).to_bytes(8))
    time.sleep(60)


def find_no_room(_: StreamSpec, pipe: Connection, *__: object) -> None:
    """Entry of a process that finds no room for its worker."""
    receive_resume(pipe)
    Sender(pipe).send(
        Tag.FAILURE, {"text": "stop another", "fatal": True, "refused": {"text": "full", "ways": [["a"]]}}
    )


def be_placed_and_wait(_: StreamSpec, pipe: Connection, *__: object) -> None:
    """Entry of a process whose worker, on another machine, takes long to start."""
    receive_resume(pipe)
    sender = Sender(pipe)
    sender.send(Tag.PLACED, {"node": "far"})
    time.sleep(2)
    sender.send(Tag.END)


@pytest.mark.long
@pytest.mark.parametrize(
    ("entry", "ending"),
    [
        (grow_elsewhere, Ending("the worker took 1000000 MB of memory")),
        (find_no_room, Ending("stop another", fatal=True, refused=Shortage("full", (("a",),)))),
        (be_placed_and_wait, Ending("the source has ended", done=True)),
    ],
)
def test_a_worker_elsewhere_is_watched_by_what_it_tells(entry: Callable[..., None], ending: Ending) -> None:
    heartbeat = 30 if entry is grow_elsewhere else 1  # of several faults, silence would be told first
    watched = WorkerSettings(heartbeat_seconds=heartbeat, attempts=1, first_delay_seconds=0.01)
    owner = Reports()
    spec = StreamSpec(play=Path("none.slod"))
    asyncio.run(asyncio.wait_for(Supervisor(spec, watched, 1000, owner, entry=entry).run(), 60))
    assert set(owner.endings) == {ending}
    assert (owner.tags.count(Tag.PLACED) == len(owner.endings)) is (entry is not find_no_room)


def send_rubbish(_: StreamSpec, pipe: Connection, *__: object) -> None:
    """Entry of a process that sends a keyframe, and another one that is damaged."""
    receive_resume(pipe)
    sender, keyframe = Sender(pipe), encode_keyframe(make_scene((5, 10)), time_ns=0, profile=0)
    sender.send(Tag.PACKET, keyframe)
    sender.send(Tag.PACKET, keyframe[:-20] + bytes(20))
    time.sleep(60)


class Decoding(Reports):
    """Decodes what it hears, as a stream does."""

    async def on_message(self, tag: Tag, body: bytes) -> None:
        await super().on_message(tag, body)
        if tag is Tag.PACKET:
            SceneDecoder().push(body)


@pytest.mark.long
def test_a_worker_that_sends_rubbish_is_replaced_again_and_again() -> None:
    async def run() -> list[Ending]:
        owner, watched = Decoding(), WorkerSettings(attempts=1, first_delay_seconds=0.01)
        spec = StreamSpec(job=TrainJob(data=Path("none")))
        running = asyncio.create_task(Supervisor(spec, watched, 10**6, owner, entry=send_rubbish).run())
        while len(owner.endings) < 2:  # each sends a keyframe first: no two fail in a row
            await asyncio.sleep(0.01)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        return owner.endings

    endings = asyncio.run(asyncio.wait_for(run(), 60))
    assert all("unusable" in ending.text and not ending.fatal for ending in endings)


def beat_for_ever(_: StreamSpec, pipe: Connection, *__: object) -> None:
    """Entry of a process that lives and does nothing else."""
    receive_resume(pipe)
    sender = Sender(pipe)
    sender.send(Tag.REPORT, {})
    while True:
        sender.send(Tag.HEARTBEAT)
        time.sleep(0.05)


def load_slowly(spec: StreamSpec, pipe: Connection, *others: object) -> None:
    """Entry of a process that needs longer to load its code than it may later go without progress."""
    time.sleep(2)
    beat_for_ever(spec, pipe, *others)


@pytest.mark.long
def test_loading_code_is_not_a_lack_of_progress() -> None:
    async def run() -> Reports:
        owner, watched = Reports(), WorkerSettings(stall_seconds=1)
        running = asyncio.create_task(
            Supervisor(StreamSpec(play=Path("none.slod")), watched, 1000, owner, entry=load_slowly).run()
        )
        while not owner.tags and not owner.endings:
            await asyncio.sleep(0.01)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        return owner

    assert asyncio.run(run()).endings == []


@pytest.mark.long
def test_a_worker_is_not_to_blame_for_a_time_in_which_the_server_stood_still_as_well() -> None:
    async def run() -> tuple[int | None, int | None, Reports]:
        owner, watched = Reports(), WorkerSettings(heartbeat_seconds=8, stall_seconds=8)
        supervisor = Supervisor(StreamSpec(play=Path("none.slod")), watched, 1000, owner, entry=beat_for_ever)
        running = asyncio.create_task(supervisor.run())
        while not owner.tags:
            await asyncio.sleep(0.01)
        before = supervisor.pid
        assert before is not None
        os.kill(before, signal.SIGSTOP)
        time.sleep(12)  # of this program, too
        os.kill(before, signal.SIGCONT)
        await asyncio.sleep(1)
        after = supervisor.pid
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        return before, after, owner

    before, after, owner = asyncio.run(run())
    assert (after, owner.endings) == (before, [])


class Reading(Reports):
    """Reads the last state for ever, or fails to, while the worker's process begins."""

    def __init__(self, fails: bool) -> None:
        super().__init__()
        self.fails, self.reads = fails, asyncio.Event()

    async def resume_point(self) -> Resume:
        self.reads.set()
        if self.fails:
            raise OSError("the recording cannot be read")
        await asyncio.Event().wait()
        raise AssertionError


@pytest.mark.parametrize("fails", [False, True])
def test_a_worker_begins_while_the_last_state_is_read_and_does_not_outlive_that(fails: bool) -> None:
    async def run() -> tuple[int | None, Reading]:
        owner, watched = Reading(fails), WorkerSettings(attempts=1)
        supervisor = Supervisor(StreamSpec(play=Path("none.slod")), watched, 1000, owner, entry=be_placed_and_wait)
        running = asyncio.create_task(supervisor.run())
        await owner.reads.wait()
        pid = supervisor.pid
        if not fails:
            running.cancel()
        await asyncio.wait([running], timeout=60)
        return pid, owner

    pid, owner = asyncio.run(run())
    assert pid is not None
    assert not Path(f"/proc/{pid}").exists()
    assert bool(owner.endings) == fails


def end_at_once(_: StreamSpec, pipe: Connection, *__: object) -> None:
    """Entry of a process that has nothing to do."""
    receive_resume(pipe)


class CancelledWhileClearingUp(Supervisor):
    """Its task is cancelled just when it begins to clear up after a worker that has ended by itself."""

    def _kill(self) -> None:
        super()._kill()
        task = asyncio.current_task()
        assert task is not None
        asyncio.get_running_loop().call_soon(task.cancel)


@pytest.mark.long
def test_a_cancellation_while_an_ended_worker_is_cleared_up_is_not_lost() -> None:
    async def run() -> tuple[bool, Reports]:
        owner, watched = Reports(), WorkerSettings(attempts=3, first_delay_seconds=0.01)
        spec = StreamSpec(play=Path("none.slod"))
        running = asyncio.create_task(CancelledWhileClearingUp(spec, watched, 1000, owner, entry=end_at_once).run())
        await asyncio.wait([running], timeout=60)
        return running.cancelled(), owner

    cancelled, owner = asyncio.run(run())
    assert cancelled
    assert owner.endings == []


def test_a_deleted_stream_is_not_started_again(clip: Clip) -> None:
    async def run() -> bool:
        stream = WorkerStream(StreamSpec(play=clip.path), Settings())
        await stream.delete(erase=True)
        stream.start()  # by a request that had found the stream before
        try:
            return stream.is_running
        finally:
            await stream.stop()

    assert not asyncio.run(run())


def test_specifications_travel_as_json() -> None:
    jobs = TrainJob(data=Path("x"), train=("cam01",), views=3), TrainJob(live={"fps": 30}), TrainJob(live=Path("rig"))
    for spec in (*(StreamSpec("a-1", job) for job in jobs), StreamSpec("b", play=Path("y"), loop=False)):
        assert spec_from_json(json.loads(json.dumps(spec.to_json()))) == spec
    assert spec_from_json({"id": "a", "data": "x"}).job == TrainJob(data=Path("x"), preset="live")
    both = {"id": "a", "live": "x", "data": "y"}
    for values in ({"id": "a"}, {"id": "A", "play": "x"}, {"id": "a", "play": "x", "data": "y"}, {"other": 1}, both):
        with pytest.raises(InputError):
            spec_from_json(values)
