"""Training from Python: what is refused before any of it, and paths that are text."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from streamlod.core.errors import InputError
from streamlod.core.synthetic import SyntheticSpec
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.offline import train_recording
from streamlod.server.pipeline.stages.opened import open_job
from tests.server.brief import brief_training

SPEC = SyntheticSpec(cameras=3, frames=2, width=64, height=36)


def job(**options: Any) -> TrainJob:
    return TrainJob(**{"synthetic": asdict(SPEC), "preset": "live", "points": "random", **options})


def test_text_is_a_path_and_a_list_names_cameras(tmp_path: Path) -> None:
    assert TrainJob(data=str(tmp_path), test=["cam00"]) == TrainJob(data=tmp_path, test=("cam00",))  # type: ignore[arg-type]
    with brief_training():
        figures = train_recording(job(frames=1), str(tmp_path / "new" / "a.slod"))
    assert figures.frames == 1
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"a.slod", "a.slod.json"}


def test_a_place_that_cannot_be_written_is_refused_before_training(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for out in (tmp_path, tmp_path / "file" / "a.slod", tmp_path / "a.mp4"):
        with pytest.raises(InputError, match=r"is a folder|cannot be written|is called like mp4"):
            train_recording(job(), out, lambda frame: pytest.fail("a frame was trained"))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        ({"test": "cam00"}, "test: must be a list of names, not 'cam00'"),
        ({"train": (1,)}, "train: must be a list of names"),
        ({"frames": 1.5}, "frames: must be a whole number, not 1.5"),
        ({"frames": True}, "frames: must be a whole number"),
        ({"downscale": "2"}, "downscale: must be a number, not '2'"),
        ({"set": "keyframe.steps=5"}, "set: must be a table of names and values"),
        ({"train": ["cam01", "cam02"], "test": ["cam02"]}, "train: cam02 cannot both train and be held out"),
    ],
)
def test_jobs_that_cannot_be_meant_are_refused(options: dict[str, Any], fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        job(**options)


@pytest.mark.parametrize("chosen", [{"train": ["cam77"]}, {"train": ["cam01"], "test": ["cam77"]}])
def test_cameras_that_do_not_exist_are_refused(chosen: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="there is no camera cam77; there are cam00, cam01, cam02"):
        open_job(job(**chosen))
