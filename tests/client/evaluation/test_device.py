"""A study that is trained on a GPU: on the pretend device where there is none (`tests.device`)."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from streamlod.client.evaluation.options import StudyOptions
from streamlod.client.evaluation.rows import study_rows
from streamlod.client.evaluation.study import run_study
from tests.client.evaluation.conftest import shortened
from tests.device.pretend import counted


@pytest.mark.slow
@pytest.mark.cuda
def test_a_study_on_a_gpu_measures_what_one_on_the_cpu_does(clip: Path, tmp_path: Path, gpu: str) -> None:
    (ours, *_) = study_rows("live", [])
    row = replace(ours, config=shortened(ours.config))
    found = {}
    for device in ("cpu", "cuda"):
        with counted() as counts:
            options = StudyOptions(views=(2,), frames=2, seeds=1, device=device)
            run_study(clip, tmp_path / device, options, (row,))
        (entry,) = json.loads((tmp_path / device / "study.json").read_text())["splits"]
        found[device] = entry["rows"][0]["summary"]["psnr"]["mean"]
        assert bool(counts.launches) == (device == "cuda" and gpu != "cuda")
    assert found["cuda"] > found["cpu"] - 0.5
