"""Pictures to packets: what the worker process and `streamlod train` run."""

from __future__ import annotations

import json
import multiprocessing
import threading
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_residual
from streamlod.codec.packet.info import peek
from streamlod.codec.packet.packet import PacketKind
from streamlod.core.camera.space import Similarity
from streamlod.core.errors import InputError, ModelError
from streamlod.core.frames import FrameSet
from streamlod.core.scene.anchors import Scene
from streamlod.core.train import TrainedFrame, Trainer
from streamlod.core.train.progress import Progress
from streamlod.server.pipeline.clip import train_clip
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.stages.encoding import EncodedFrame
from streamlod.server.pipeline.stages.opened import open_job
from streamlod.server.pipeline.stages.stream import train_stream
from streamlod.server.pipeline.stages.trace import Span
from streamlod.server.worker.messages import Resume, Sender, Tag
from streamlod.server.worker.training import show_again, train
from tests.core.data import writers
from tests.server.brief import brief_training
from tests.server.pipeline.jobs import JOB, SPEC

pytestmark = pytest.mark.usefixtures("short_runs")


def decoded(frames: list[EncodedFrame], decoder: SceneDecoder | None = None) -> Scene:
    """The state after all packets of `frames`."""
    decoder = decoder or SceneDecoder()
    for frame in frames:
        for packet in frame.packets:
            decoder.push(packet)
    assert decoder.scene is not None
    return decoder.scene


def test_frames_are_announced_where_they_are_read_ahead_of_training() -> None:
    seen, two = list[tuple[int, str]](), threading.Event()

    def announce(frame: FrameSet) -> None:
        seen.append((frame.index, threading.current_thread().name))
        if len(seen) == 2:
            two.set()

    frames = open_job(JOB).frames(0, announce)
    assert next(frames)[0].index == 0
    assert two.wait(30)  # though nobody has asked for the second one
    assert [frame.index for frame, _ in frames] == [1, 2, 3]
    assert seen == [(index, "prefetch") for index in range(4)]


def test_controllers_keep_every_frame_and_the_decoders_state(job: TrainJob, tmp_path: Path) -> None:
    """A budget of a millisecond and next to no bytes: frames come all the same, and they decode."""
    seen = list[EncodedFrame]()
    tight = replace(job, frame_budget_ms=1.0, target_kbps=20.0)
    train_clip(open_job(tight), tmp_path / "scene.slod", seen.append)
    assert [frame.version for frame in seen] == [0, 1, 2, 3]
    assert all("encode" in frame.report["seconds"] for frame in seen)
    assert decoded(seen).version == 3
    assert max(len(frame.packets[0]) for frame in seen[1:]) < 2500  # of a bucket that holds a second of 20 kbit


@pytest.mark.parametrize("wrong", [{"frame_budget_ms": 0.0}, {"target_kbps": -1.0}, {"target_kbps": float("inf")}])
def test_budgets_and_rates_that_are_none_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match="must lie between"):
        replace(JOB, **wrong)  # type: ignore[arg-type]


def overlap(ones: list[Span], others: list[Span]) -> float:
    """Seconds that spans of both kinds have in common."""
    return sum(max(0.0, min(a.end, b.end) - max(a.begin, b.begin)) for a in ones for b in others)


def test_the_stages_of_three_frames_run_side_by_side(trained: tuple[Path, list[EncodedFrame]]) -> None:
    _, frames = trained

    def track(name: str, chosen: list[EncodedFrame]) -> list[Span]:
        return [span for frame in chosen for span in frame.spans if span.track == name]

    assert [span.track for span in frames[2].spans if span.track != "train"] == ["read", "encode", "write"]
    assert {span.name for span in track("train", frames)} >= {"points", "seed", "train", "partition", "round"}
    for name in ("read", "train", "encode", "write"):  # within a track, one after the other
        spans = track(name, frames)
        assert all(a.end <= b.begin for a, b in pairwise(spans))
    assert overlap(track("read", frames[1:]), track("train", frames[:-1])) > 0
    assert overlap(track("encode", frames[:-1]), track("train", frames[1:])) > 0
    assert overlap(track("encode", frames), track("write", frames)) == 0


def test_a_failing_encoder_ends_the_stream_and_the_training(job: TrainJob, monkeypatch: pytest.MonkeyPatch) -> None:
    def encode(before: Scene, *arguments: object, **options: object) -> bytes:
        if before.version == 1:
            raise ModelError("the encoder broke")
        return encode_residual(before, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr("streamlod.server.pipeline.stages.encoding.encode_residual", encode)
    frames = train_stream(open_job(job))
    assert [next(frames).version, next(frames).version] == [0, 1]
    with pytest.raises(ModelError, match="the encoder broke"):
        next(frames)
    assert "training" not in [thread.name for thread in threading.enumerate()]


def test_a_failing_trainer_ends_the_stream_after_what_it_made(job: TrainJob, monkeypatch: pytest.MonkeyPatch) -> None:
    predict = Trainer.predict

    def broken(self: Trainer, frames: FrameSet) -> TrainedFrame:
        if frames.index == 2:
            raise ModelError("the trainer broke")
        return predict(self, frames)

    monkeypatch.setattr(Trainer, "predict", broken)
    frames = train_stream(open_job(job))
    assert [next(frames).version, next(frames).version] == [0, 1]
    with pytest.raises(ModelError, match="the trainer broke"):
        next(frames)


@pytest.mark.long
def test_previews_come_first_and_the_chain_holds(job: TrainJob) -> None:
    with brief_training(steps=60):
        frames = list(train_stream(open_job(job), previews=True))
    previews = [frame for frame in frames if frame.preview]
    assert len(previews) == 3  # the draft, and one for each progress report of so short a run
    assert previews[0].report["fraction"] == 0
    assert frames[: len(previews)] == previews
    assert [frame.version for frame in frames] == list(range(7))
    assert decoded(frames).version == 6


def test_the_first_frame_is_told_of_to_its_end(job: TrainJob) -> None:
    told: list[Progress] = []
    with brief_training(steps=30), closing(train_stream(open_job(job), on_progress=told.append)) as frames:
        next(frames)
    fractions = [progress.fraction for progress in told]
    assert (fractions, fractions[-1]) == (sorted(fractions), 1.0)


@pytest.mark.long
@pytest.mark.usefixtures("trained")  # the first training of a process may have other threads than all after it
def test_the_seed_reaches_the_training(job: TrainJob) -> None:
    """The same one gives the same keyframe to the byte, but for its identifier; another one another."""

    def content(packet: bytes) -> bytes:
        """What lies before and behind the identifier and the checksum over it (codec/FORMAT.md, section 2)."""
        return packet[:32] + packet[44:]

    jobs = [replace(job, seed=seed) for seed in (0, 0, 1)]
    keyframes = [next(iter(train_stream(open_job(job)))).packets[0] for job in jobs]
    assert content(keyframes[0]) == content(keyframes[1])
    assert keyframes[0] != keyframes[1], "two runs cannot be mixed"
    assert content(keyframes[2]) != content(keyframes[0])


def test_a_restarted_run_goes_on_with_a_keyframe_of_the_old_state(
    job: TrainJob, trained: tuple[Path, list[EncodedFrame]]
) -> None:
    first, decoder = trained[1][:2], SceneDecoder()
    assert decoded(first, decoder).version == 1
    ours, theirs = multiprocessing.Pipe(duplex=False)
    with ours, theirs:
        scene = show_again(Resume(tuple(frame.packets[0] for frame in first), 2), Sender(theirs))
        train(job, scene, 2, Sender(theirs))
        messages = []
        while ours.poll():
            data = ours.recv_bytes()
            messages.append((Tag(data[0]), data[1:]))
    packets = [body for tag, body in messages if tag is Tag.PACKET]
    assert [peek(packet).kind for packet in packets] == [PacketKind.KEY, PacketKind.CHANGE, PacketKind.CHANGE]
    assert [peek(packet).to_version for packet in packets] == [2, 3, 4]
    for packet in packets:
        decoder.push(packet)
    reports = [json.loads(body) for tag, body in messages if tag is Tag.REPORT]
    assert [report.get("done") for report in reports] == [2, None, None]
    assert messages[:2] == [(Tag.PACKET, packets[0]), (Tag.REPORT, json.dumps(reports[0]).encode())]


def test_a_run_goes_on_in_the_space_of_the_state(job: TrainJob, trained: tuple[Path, list[EncodedFrame]]) -> None:
    """A recording of an earlier version, or of a rig that was described anew, has its cameras elsewhere."""
    scene, opened = decoded(trained[1][:1]), open_job(job)
    there = opened.dataset.placed(Similarity(7.0, np.eye(3), np.array([1.0, 2.0, 3.0])))
    continued = replace(opened, dataset=there, rig=there.cameras).continuing(scene)
    known = {camera.name: camera for camera in scene.header.cameras}
    assert len(continued.rig) == SPEC.cameras - 1
    for camera in (*continued.rig, *continued.dataset.cameras):
        # the state's own cameras stand on the grid of the space of training
        np.testing.assert_allclose(camera.world_to_camera, known[camera.name].world_to_camera, rtol=0, atol=2**-20)


@pytest.mark.long
def test_of_more_cameras_than_a_header_holds_those_that_train_are_offered(tmp_path: Path) -> None:
    cameras = writers.rig([f"IMG_{number:04d}" for number in range(256)], (32, 16))
    entries = [(f"{camera.name}.png", camera, "PINHOLE") for camera in cameras]
    writers.write_colmap_binary(tmp_path / "sparse" / "0", entries, np.zeros((0, 6)))
    for camera in cameras:
        writers.write_picture(tmp_path / "images" / f"{camera.name}.png", writers.picture(0, 0, (32, 16)))
    assert len(open_job(TrainJob(data=tmp_path, views=4)).rig) == 4
    assert len(open_job(TrainJob(data=tmp_path, test=("IMG_0007",))).rig) == 255
    with pytest.raises(InputError, match="256 cameras are too many to train on; the most is 255"):
        open_job(TrainJob(data=tmp_path))


def test_viewers_are_offered_cameras_as_they_stood(tmp_path: Path) -> None:
    cameras = list(writers.rig(["a", "b", "c"], (32, 16)))
    cameras[1] = replace(writers.rig(["b"], (16, 32))[0], world_to_camera=cameras[1].world_to_camera)
    writers.write_transforms(tmp_path, [f"{camera.name}.png" for camera in cameras], cameras)
    for camera in cameras:
        size = camera.width, camera.height
        writers.write_picture(tmp_path / f"{camera.name}.png", writers.picture(0, 0, size))
    opened = open_job(TrainJob(data=tmp_path))
    assert [(camera.width, camera.height) for camera in opened.dataset.cameras] == [(32, 16)] * 3
    assert [(camera.width, camera.height) for camera in opened.rig] == [(32, 16), (16, 32), (32, 16)]


def test_keyframes_come_at_the_interval(job: TrainJob) -> None:
    frames = list(train_stream(open_job(replace(job, keyframe_interval=2))))
    kinds = [[peek(packet).kind for packet in frame.packets] for frame in frames]
    key, predicted = PacketKind.KEY, PacketKind.CHANGE
    assert kinds == [[key], [predicted], [predicted, key], [predicted]]
    assert decoded(frames).version == 3


def test_a_camera_that_does_not_exist_is_refused() -> None:
    with pytest.raises(InputError, match="cam99"):
        open_job(replace(JOB, test=("cam99",)))
