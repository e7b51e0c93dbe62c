"""Where a stream's next worker continues, by what the ones before did and what is recorded of them."""

from __future__ import annotations

import asyncio
import json
import os
import time
from pathlib import Path
from typing import Any

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.packet.info import peek
from streamlod.core.scene.keyframe import as_keyframe
from streamlod.core.scene.residual import difference
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Retention, Settings
from streamlod.server.stream.recording.store import Store
from streamlod.server.stream.worker.restoring import MAX_AWAY_SECONDS
from streamlod.server.stream.worker_stream import WorkerStream
from streamlod.server.worker.messages import Resume, Tag
from tests.codec.scenes import assert_same_state, move
from tests.server.conftest import Clip


async def trained(folder: Path, spec: StreamSpec, packets: list[bytes], resumed: int) -> tuple[int, Resume]:
    """Start a stream on `folder` and take a worker's packets, of which the first is the state after `resumed` frames.

    Returns the newest version that it found on the disk, or -1, and where it would have had its worker continue.
    """
    store = Store(folder, Retention())
    try:
        stream = WorkerStream(spec, Settings(state=folder), store.recording(spec.id))
        await stream.work.restore()
        found = stream.newest.version if stream.newest else -1
        resume = await stream.work.resume_point()
        for number, packet in enumerate(packets):
            await stream.work.on_message(Tag.PACKET, packet)
            if {peek(packet).to_version} == {peek(other).to_version for other in packets[number + 1 : number + 2]}:
                continue  # both are of one frame
            report = {"version": peek(packet).to_version, **({"done": resumed} if resumed else {})}
            await stream.work.on_message(Tag.REPORT, json.dumps(report).encode())
        return found, resume
    finally:
        store.close()


def test_training_continues_from_a_recent_recording_of_the_same_source(tmp_path: Path, clip: Clip) -> None:
    def spec(**fields: Any) -> StreamSpec:
        return StreamSpec(job=TrainJob(synthetic={"cameras": 3}, **fields))

    def start(folder: str, spec: StreamSpec, *packets: bytes, resumed: int = 0) -> tuple[int, Resume]:
        return asyncio.run(trained(tmp_path / folder, spec, list(packets), resumed))

    assert start("a", spec(), *clip.packets[:7]) == (-1, Resume())
    found, resume = start("a", spec())
    assert (found, resume.frames) == (6, 7)
    decoder = SceneDecoder()
    for packet in resume.packets:
        decoder.push(packet)
    assert_same_state(clip.states[6], decoder.scene)
    again = as_keyframe(clip.states[6], 7)  # what the worker sends first; the server is killed before any frame
    assert start("a", spec(), encode_keyframe(again, time_ns=1), resumed=7)[1].frames == 7
    found, resume = start("a", spec())
    assert (found, resume.frames) == (7, 7)
    assert start("a", spec(seed=3))[1] == Resume()  # other options
    newest = max((tmp_path / "a" / "streams" / "main").glob("*.slod"))
    os.utime(newest, (0, time.time() - MAX_AWAY_SECONDS - 1))
    assert start("a", spec())[1] == Resume()
    assert start("b", StreamSpec(play=clip.path), *clip.packets[:7])[1] == Resume()
    assert start("b", StreamSpec(play=clip.path))[1] == Resume()  # a file is played from its begin


def test_what_was_recorded_after_a_keyframe_in_mid_stream_is_shown_and_trained_on(tmp_path: Path, clip: Clip) -> None:
    """Such a keyframe has the version of the change before it, which ends the group of pictures before."""
    spec = StreamSpec(job=TrainJob(synthetic={"cameras": 3}))
    time_ns = peek(clip.packets[5]).time_ns
    refreshed = as_keyframe(clip.states[5], 5)
    change = difference(refreshed, move(refreshed, seed=6))
    after = encode_residual(refreshed, change, time_ns=2 * time_ns, profile=0)
    packets = [*clip.packets[:6], encode_keyframe(refreshed, time_ns=time_ns), after]
    asyncio.run(trained(tmp_path, spec, packets, 0))
    assert len(list(tmp_path.rglob("*.slod"))) == 2
    found, resume = asyncio.run(trained(tmp_path, spec, [], 0))
    assert (found, resume.frames) == (6, 7)


def test_a_stream_that_is_changed_begins_with_its_first_frame(clip: Clip) -> None:
    async def run() -> Resume:
        stream = WorkerStream(StreamSpec(job=TrainJob(synthetic={"cameras": 3})), Settings())
        await stream.work.on_message(Tag.PACKET, clip.packets[0])
        await stream.work.on_message(Tag.REPORT, b'{"version": 0}')
        assert (await stream.work.resume_point()).frames == 1
        stream.define(StreamSpec(job=TrainJob(synthetic={"cameras": 4})), None)
        return await stream.work.resume_point()

    assert asyncio.run(run()) == Resume()
