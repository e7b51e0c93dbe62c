"""A clip is trained into a file: what it holds, and what is kept where something fails."""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from streamlod.codec.container import SlodReader
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.sound.opus import SAMPLE_RATE
from streamlod.core.data.dataset import FPS_OF_PICTURES
from streamlod.core.errors import InputError, TrainingCutShort
from streamlod.core.synthetic import open_synthetic
from streamlod.core.train import Trainer
from streamlod.server.pipeline.clip import train_clip
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.stages.encoding import EncodedFrame
from streamlod.server.pipeline.stages.opened import open_job
from tests.clicks import write_sounding
from tests.core.data.writers import write_colmap_binary, write_picture
from tests.opus import read_sound
from tests.server.pipeline.jobs import FACTS, JOB, SPEC
from tests.small_disk import files_up_to

pytestmark = pytest.mark.usefixtures("short_runs")


def test_a_clip_becomes_a_file_that_plays(trained: tuple[Path, list[EncodedFrame]]) -> None:
    folder, seen = trained
    assert [frame.version for frame in seen] == [0, 1, 2, 3]
    assert sorted(path.name for path in folder.iterdir()) == ["scene.slod", "scene.slod.json"]
    decoder = SceneDecoder()
    with SlodReader(folder / "scene.slod") as reader:
        for packet in reader.packets():
            decoder.push(packet)
    assert decoder.scene is not None
    assert decoder.scene.version == 3
    told = decoder.scene.metadata
    assert {"title": told.title, "licence": told.licence} == FACTS
    assert told.exposures is not None
    assert len(told.exposures) == 5
    assert [camera.name for camera in decoder.scene.header.cameras] == [f"cam{n:02d}" for n in range(5)]
    figures = json.loads((folder / "scene.slod.json").read_text())
    first, *later = [frame.report["total_seconds"] for frame in seen]
    assert figures["trained_cameras"] == ["cam01", "cam02", "cam03", "cam04"]
    assert figures["first_frame_seconds"] == first > 0
    assert figures["train_seconds"] == pytest.approx(sum(later) / 3)
    assert min(later) > 0
    assert set(figures["per_frame"][1]["seconds"]) >= {"partition", "round", "encode"}


def test_an_interrupted_run_leaves_nothing(job: TrainJob, tmp_path: Path) -> None:
    def interrupt(frame: EncodedFrame) -> None:
        if frame.version == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_clip(open_job(job), tmp_path / "scene.slod", interrupt)
    assert list(tmp_path.iterdir()) == []


def _photographs(folder: Path, instants: int) -> TrainJob:
    """A job for pictures in files, which are trained in full size."""
    dataset = open_synthetic(SPEC)
    entries = [(f"{camera.name}.png", camera, "PINHOLE") for camera in dataset.cameras]
    write_colmap_binary(folder / "sparse" / "0", entries, np.zeros((0, 6)))
    for frame in dataset.frames(0, instants):
        for camera, image in zip(dataset.cameras, frame.images, strict=True):
            write_picture(folder / "frames" / f"{frame.index:04d}" / f"{camera.name}.png", image)
    return replace(JOB, synthetic=None, data=folder, test=(), frames=None)


def test_a_late_fault_keeps_what_was_trained(job: TrainJob, tmp_path: Path) -> None:
    late = replace(_photographs(tmp_path / "data", 3), points=job.points)
    for picture in (tmp_path / "data" / "frames" / "0002").iterdir():
        picture.write_bytes(picture.read_bytes()[:-500])
    write_sounding(tmp_path / "recorder.wav", 1.0, "pcm_s16le", pictures=False)
    seen, out = list[EncodedFrame](), tmp_path / "scene.slod"
    with pytest.raises(
        TrainingCutShort, match=r"frame 2 has no picture from any camera; .*scene\.slod holds the first 2 of 3 frames"
    ) as caught:
        train_clip(open_job(late), out, seen.append, sound=str(tmp_path / "recorder.wav"))
    assert (caught.value.kept, caught.value.wanted) == (2, 3)
    with SlodReader(out) as reader:
        assert [*reader.packets()] == [p for frame in seen for p in frame.packets]
    assert len(seen) == 2
    heard = sum(map(len, read_sound(tmp_path / "scene.slod.opus")))
    assert heard == round(2 * SAMPLE_RATE / FPS_OF_PICTURES)  # as long as the pictures that were kept
    assert json.loads((tmp_path / "scene.slod.json").read_text())["cut_short"] == str(caught.value)


def test_a_full_disk_keeps_what_was_trained(job: TrainJob, tmp_path: Path) -> None:
    out = tmp_path / "scene.slod"
    with ExitStack() as disk:

        def fill(frame: EncodedFrame) -> None:
            if frame.version == 1:
                (partial,) = tmp_path.iterdir()
                disk.enter_context(files_up_to(partial.stat().st_size + 20))

        with pytest.raises(TrainingCutShort, match=r"scene\.slod: cannot be written \(.*holds the first 2 of 4 frames"):
            train_clip(open_job(job), out, fill)
    with SlodReader(out) as reader:
        assert [entry.to_version for entry in reader.entries] == [0, 1]


def test_a_fault_in_the_first_frame_leaves_nothing(job: TrainJob, tmp_path: Path) -> None:
    early = replace(_photographs(tmp_path / "data", 1), points=job.points)
    for picture in (tmp_path / "data" / "frames" / "0000").iterdir():
        picture.write_bytes(picture.read_bytes()[:-500])
    with pytest.raises(InputError):
        train_clip(open_job(early), tmp_path / "scene.slod", lambda _: None)
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


def test_an_unforeseen_fault_keeps_what_was_trained_and_its_traceback(
    job: TrainJob, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("a mistake of ours")

    monkeypatch.setattr(Trainer, "predict", fail)
    with pytest.raises(ZeroDivisionError) as caught:
        train_clip(open_job(job), tmp_path / "scene.slod", lambda _: None)
    assert "holds the first 1 of 4 frames" in caught.value.__notes__[0]
    with SlodReader(tmp_path / "scene.slod") as reader:
        assert len(reader.entries) == 1
