"""A stream trained on a GPU, in the worker's process; on the pretend device where there is none (`tests.device`)."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

import streamlod.server.worker.supervisor
from streamlod.core.synthetic import SyntheticSpec
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings, WorkerSettings
from tests.core.true_points import true_points
from tests.device import worker
from tests.server.conftest import running

SPEC = SyntheticSpec(cameras=2, frames=2, width=64, height=36)


@pytest.mark.long
@pytest.mark.cuda
def test_a_worker_trains_on_the_device_that_was_asked_for(
    gpu: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streamlod.server.worker.supervisor, "run_worker", worker.run_worker)
    points = true_points(SPEC)
    np.savez(tmp_path / "points.npz", positions=points.positions[::4], colours=points.colours[::4])
    job = TrainJob(synthetic=asdict(SPEC), preset="live", points=str(tmp_path / "points.npz"), device="cuda")
    with running(Settings(worker=WorkerSettings(spare=False)), StreamSpec(job=job)) as service:
        found = service.wait(lambda stream: stream["state"] in ("ended", "failed"), seconds=300)
        assert found["state"] == "ended", found["detail"]
        assert found["version"] == 2  # of a draft and two frames
