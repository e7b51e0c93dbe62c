"""A stream trained on a GPU, in the worker's process; on the pretend device where there is none (`tests.device`)."""

from __future__ import annotations

import pytest

import server.worker.supervisor
from server.pipeline.job import TrainJob
from server.pipeline.spec import StreamSpec
from server.settings import Settings
from tests.device import worker
from tests.server.conftest import running

CLIP: dict[str, int | float | str | bool] = {"cameras": 3, "frames": 3, "width": 64, "height": 36}


@pytest.mark.cuda
def test_a_worker_trains_on_the_device_that_was_asked_for(gpu: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server.worker.supervisor, "run_worker", worker.run_worker)
    job = TrainJob(synthetic=CLIP, preset="live", points="random", device="cuda")
    with running(Settings(), StreamSpec(job=job)) as service:
        found = service.wait(lambda stream: stream["state"] in ("ended", "failed"), seconds=120)
        assert found["state"] == "ended", found["detail"]
        assert found["version"] == 2  # of three frames
