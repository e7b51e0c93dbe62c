"""A real training worker behind the server, killed in mid-frame."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from server.job import TrainJob
from server.settings import Settings
from server.spec import StreamSpec
from tests.server.conftest import running, viewing

CLIP = {"cameras": 4, "frames": 6, "width": 120, "height": 68}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_killed_trainer_goes_on_from_the_last_state(tmp_path: Path) -> None:
    spec = StreamSpec(job=TrainJob(synthetic=CLIP, preset="live"))
    with running(Settings(state=tmp_path), spec) as server, viewing(server) as viewer:
        viewer.hello()
        assert viewer.welcome["window"] is None
        assert viewer.until("state", 120)["state"] == "live"  # after progress and early pictures
        assert viewer.named("progress")
        pid = server.registry.streams["main"].worker_pid
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        while viewer.named("state")[-1]["state"] != "ended":
            viewer.step(60)
        found = server.stream()
        assert (found["state"], found["restarts"], found["epoch"]) == ("ended", 1, 2)
        assert [event["state"] for event in viewer.named("state")] == ["live", "degraded", "live", "ended"]
        assert len(set(viewer.decoder.versions)) == 1
        assert viewer.decoder.versions[0] == found["version"]
