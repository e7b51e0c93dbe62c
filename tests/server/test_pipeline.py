"""Pictures to packets: what the worker process and `streamlod train` run."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from codec.container import SlodReader
from codec.decoder import SceneDecoder
from codec.packet import PacketKind, peek
from core.data.synthetic import SyntheticSpec
from core.errors import InputError
from core.train import config as train_config
from core.train import preset
from server.job import TrainJob
from server.pipeline import EncodedFrame, open_job, train_clip, train_stream

SPEC = SyntheticSpec(cameras=5, frames=4, width=96, height=54, seed=2)
JOB = TrainJob(synthetic=asdict(SPEC), test=("cam00",), preset="live")


@pytest.fixture(autouse=True)
def short_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first frame of 60 steps: these tests are about what flows, not about quality."""

    def brief(name: str) -> train_config.TrainConfig:
        config = preset(name)
        return replace(
            config,
            keyframe=replace(config.keyframe, steps=60, growth_interval=20),
            predict=replace(config.predict, epochs=2, minimum_steps=8),
        )

    monkeypatch.setattr("server.pipeline.preset", brief)


def test_a_clip_becomes_a_file_that_plays(tmp_path: Path) -> None:
    out, seen = tmp_path / "scene.slod", list[EncodedFrame]()
    train_clip(open_job(JOB), out, seen.append)
    assert [frame.version for frame in seen] == [0, 1, 2, 3]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene.slod", "scene.slod.json"]
    decoder = SceneDecoder()
    with SlodReader(out) as reader:
        for packet in reader.packets():
            decoder.push(packet)
    assert decoder.scene is not None
    assert decoder.scene.version == 3
    assert [camera.name for camera in decoder.scene.header.cameras] == [f"cam{n:02d}" for n in range(5)]
    figures = json.loads((tmp_path / "scene.slod.json").read_text())
    assert figures["first_frame_seconds"] > figures["train_seconds"] > 0
    assert set(figures["per_frame"][1]["seconds"]) >= {"partition", "round", "encode"}


def test_previews_come_first_and_the_chain_holds() -> None:
    frames = list(train_stream(open_job(JOB), previews=True))
    previews = [frame for frame in frames if frame.preview]
    assert len(previews) == 2  # one for each progress report of so short a run
    assert frames[: len(previews)] == previews
    assert [frame.version for frame in frames] == list(range(6))
    decoder = SceneDecoder()
    for frame in frames:
        for packet in frame.packets:
            decoder.push(packet)
    assert decoder.scene is not None
    assert decoder.scene.version == 5


def test_a_restarted_run_goes_on_with_a_keyframe_of_the_old_state() -> None:
    first: list[EncodedFrame] = []
    for frame in train_stream(open_job(JOB)):
        first.append(frame)
        if frame.version == 1:
            break
    decoder = SceneDecoder()
    for frame in first:
        decoder.push(frame.packets[0])
    assert decoder.scene is not None
    rest = list(train_stream(open_job(JOB), resume=decoder.scene, start=2))
    kinds = [peek(frame.packets[0]).kind for frame in rest]
    assert kinds == [PacketKind.KEY, PacketKind.PREDICTED]
    assert rest[0].version > 1
    for frame in rest:
        decoder.push(frame.packets[0])


def test_keyframes_come_at_the_interval() -> None:
    frames = list(train_stream(open_job(replace(JOB, keyframe_interval=2))))
    kinds = [[peek(packet).kind for packet in frame.packets] for frame in frames]
    key, predicted = PacketKind.KEY, PacketKind.PREDICTED
    assert kinds == [[key], [predicted], [predicted, key], [predicted]]
    decoder = SceneDecoder()
    for frame in frames:
        for packet in frame.packets:
            decoder.push(packet)


def test_a_camera_that_does_not_exist_is_refused() -> None:
    with pytest.raises(InputError, match="cam99"):
        open_job(replace(JOB, test=("cam99",)))


def test_an_interrupted_run_leaves_nothing(tmp_path: Path) -> None:
    def interrupt(frame: EncodedFrame) -> None:
        if frame.version == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_clip(open_job(JOB), tmp_path / "scene.slod", interrupt)
    assert list(tmp_path.iterdir()) == []
