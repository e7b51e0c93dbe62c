"""Messages between worker and supervisor, and a worker that hangs or grows."""

from __future__ import annotations

import asyncio
import json
import math
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from streamlod.codec.container import SlodWriter
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe
from streamlod.core.errors import InputError
from streamlod.core.frames import FrameSet
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec, spec_from_json
from streamlod.server.settings import Settings, WorkerSettings
from streamlod.server.stream.worker_stream import WorkerStream
from streamlod.server.worker.camera_pictures import CameraPictures
from streamlod.server.worker.cluster.room import Shortage
from streamlod.server.worker.process import Resume, Sender, Tag, _told, play, receive_resume, send_resume
from streamlod.server.worker.supervisor import Ending, Supervisor
from tests.codec.scenes import make_scene
from tests.core.data.writers import rig
from tests.server.conftest import Clip, make_clip, running


def received(clip: Clip, resume: Resume) -> list[tuple[Tag, bytes]]:
    ours, theirs = multiprocessing.Pipe(duplex=False)
    messages = []
    with ours, theirs:
        play(StreamSpec(play=clip.path, loop=False), resume, Sender(theirs))
        while ours.poll():
            data = ours.recv_bytes()
            messages.append((Tag(data[0]), data[1:]))
    return messages


def test_nobody_waits_where_nothing_was_filmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file of an evening in which the phones were away for ten minutes, and again."""
    monkeypatch.setattr("streamlod.server.worker.process.MAX_GAP_SECONDS", 0.3)
    clip = make_clip(tmp_path / "gaps.slod", 3, counts=(5, 10), frame_ns=600 * 10**9)
    begin = time.monotonic()
    assert len([tag for tag, _ in received(clip, Resume()) if tag is Tag.PACKET]) == 3
    assert 0.6 <= time.monotonic() - begin < 60


def test_a_file_is_played_packet_by_packet(clip: Clip, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.sleep", lambda _: None)
    monkeypatch.setattr("streamlod.server.worker.process.Sender.send", collect := Collector())
    received(clip, Resume())
    assert [body for tag, body in collect.messages if tag is Tag.PACKET] == clip.packets
    collect.messages.clear()
    received(clip, Resume(frames=75))
    assert [body for tag, body in collect.messages if tag is Tag.PACKET] == clip.packets[60:]


def damage(clip: Clip, *versions: int) -> None:
    """Change a byte in the middle of the packets of these versions."""
    data = bytearray(clip.path.read_bytes())
    for version in versions:
        at = data.index(clip.packets[version]) + len(clip.packets[version]) // 2
        data[at] ^= 1
    clip.path.write_bytes(data)


def test_what_is_damaged_of_a_file_is_left_out_up_to_the_next_keyframe(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = make_clip(tmp_path / "clip.slod", 9, counts=(5, 10), key_every=3, frame_ns=1)
    damage(clip, 1, 6)
    monkeypatch.setattr("streamlod.server.worker.process.Sender.send", collect := Collector())
    received(clip, Resume())
    assert [body for tag, body in collect.messages if tag is Tag.PACKET] == [clip.packets[n] for n in (0, 3, 4, 5)]
    left_out = [record.getMessage() for record in caplog.records]
    assert [line.split(": ")[1] for line in left_out] == [
        f"left out from frame {n} up to the next keyframe" for n in (1, 6)
    ]


@pytest.mark.parametrize("frames", [3, 12])
def test_a_file_that_is_written_over_while_it_is_played_follows_at_the_next_round(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, frames: int
) -> None:
    clip = make_clip(tmp_path / "clip.slod", 6, counts=(5, 10), key_every=3, frame_ns=1)
    other = make_clip(tmp_path / "other.slod", frames, counts=(10, 20), key_every=3, frame_ns=1)
    monkeypatch.setattr("streamlod.server.worker.process.MAX_GAP_SECONDS", 0.0)
    rounds: list[list[bytes]] = [[]]

    def send(_: Sender, tag: Tag, body: bytes = b"") -> None:
        if tag is Tag.PACKET:
            rounds[-1].append(body)
        if tag is Tag.EPOCH:
            if len(rounds) == 2:
                raise ConnectionResetError
            rounds.append([])
            clip.path.write_bytes(other.path.read_bytes())

    monkeypatch.setattr("streamlod.server.worker.process.Sender.send", send)
    with pytest.raises(ConnectionResetError):
        play(StreamSpec(play=clip.path), Resume(), Sender(multiprocessing.Pipe()[1]))
    assert rounds == [clip.packets, other.packets]


def test_a_file_of_which_nothing_is_whole_fails_with_a_sentence_and_is_not_tried_again(tmp_path: Path) -> None:
    clip = make_clip(tmp_path / "clip.slod", 3, counts=(5, 10))
    damage(clip, 0)
    with running(Settings(), StreamSpec(play=clip.path)) as server:
        found = server.wait(lambda stream: stream["state"] == "failed")
    assert found["restarts"] == 0
    assert found["detail"] == f"{clip.path}: is damaged: none of its keyframes is whole"


@pytest.mark.parametrize("places", [(0, 3), (0, 1, 2)])  # a change of another keyframe, and a version that was before
def test_a_file_whose_packets_do_not_belong_together_is_not_tried_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, places: tuple[int, ...]
) -> None:
    one, other = (make_clip(tmp_path / f"{n}.slod", 2, counts=(5, n)) for n in (10, 20))
    mixed, packets = tmp_path / "mixed.slod", one.packets + other.packets
    with SlodWriter(mixed) as writer:
        for place in places:
            writer.append(packets[place])
    with running(Settings(), StreamSpec(play=mixed)) as server:
        found = server.wait(lambda stream: stream["state"] == "failed")
    assert found["restarts"] == 0
    assert found["detail"].startswith(f"{mixed} cannot be decoded (")
    assert not [record for record in caplog.records if record.exc_info]


def test_where_to_go_on_is_told_by_pipe_however_long_it_is() -> None:
    resume = Resume((bytes(3_000_000), b"residual"), 7)
    ours, theirs = multiprocessing.Pipe()
    with ours, theirs, ThreadPoolExecutor(1) as pool:
        sent = pool.submit(send_resume, resume, ours)
        assert receive_resume(theirs) == resume
        sent.result(60)


class Collector:
    """Stands in for a pipe that somebody empties."""

    def __init__(self) -> None:
        self.messages: list[tuple[Tag, object]] = []

    def __call__(self, tag: Tag, body: object = b"") -> None:
        self.messages.append((tag, body))


class _Filmed:
    """A job without figures."""

    def statistics(self) -> None:
        return None


def test_what_tells_of_cameras_ends_quietly_with_the_server() -> None:
    ours, theirs = multiprocessing.Pipe(duplex=False)
    ours.close()
    pictures, job = CameraPictures(rig(["cam"], (8, 8))), _Filmed()
    pictures.note(FrameSet(0, 0, np.zeros((1, 8, 8, 3), np.uint8), np.ones(1, np.bool_)))
    with theirs, _told(job, pictures, Sender(theirs)):  # type: ignore[arg-type]
        (teller,) = (each for each in threading.enumerate() if each.name == "ingest statistics")
        teller.join(60)  # what it raised would be a warning, and so an error
        assert not teller.is_alive()


def test_figures_become_plain_json() -> None:
    ours, theirs = multiprocessing.Pipe(duplex=False)
    with ours, theirs:
        figures = {"loss": math.nan, "seconds": {"train": np.float32(0.5)}, "frames": np.int64(3), "text": "x"}
        Sender(theirs).send(Tag.REPORT, figures)
        data = ours.recv_bytes()
    assert data[0] == Tag.REPORT
    assert json.loads(data[1:]) == {"loss": None, "seconds": {"train": 0.5}, "frames": 3.0, "text": "x"}


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
