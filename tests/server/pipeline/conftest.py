"""A job and what is trained of it, for tests of the pipeline."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from streamlod.server.pipeline.clip import train_clip
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.stages.encoding import EncodedFrame
from streamlod.server.pipeline.stages.opened import open_job
from tests.core.true_points import true_points
from tests.server.brief import brief_training
from tests.server.pipeline.jobs import FACTS, JOB, SPEC


@pytest.fixture(scope="module")
def short_runs() -> Iterator[None]:
    """Frames of few steps."""
    with brief_training():
        yield


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> TrainJob:
    """`JOB` with points from a file."""
    path, points = tmp_path_factory.mktemp("points") / "points.npz", true_points(SPEC)
    np.savez(path, positions=points.positions, colours=points.colours)
    return replace(JOB, points=str(path))


@pytest.fixture(scope="module")
def trained(
    short_runs: None, job: TrainJob, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list[EncodedFrame]]:
    """A folder with the clip as a file, and its frames as they were handed on."""
    folder, seen = tmp_path_factory.mktemp("trained"), list[EncodedFrame]()
    train_clip(open_job(replace(job, **FACTS)), folder / "scene.slod", seen.append)
    return folder, seen
