"""A real training worker behind the server, killed in mid-frame."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from pathlib import Path

import pytest

from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
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
        pid = server.worker_stream().worker_pid
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        while viewer.named("state")[-1]["state"] != "ended":
            viewer.step(60)
        found = server.stream()
        assert (found["state"], found["restarts"], found["epoch"]) == ("ended", 1, 2)
        assert [event["state"] for event in viewer.named("state")] == ["live", "degraded", "live", "ended"]
        assert len(set(viewer.decoder.versions)) == 1
        assert viewer.decoder.versions[0] == found["version"]


def cpu_ticks(pid: int) -> int:
    """Processor time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return int(fields[11]) + int(fields[12])


def until_ready(pid: int) -> None:
    """Wait for a process that has loaded all that training takes, and rests."""
    limit, before = time.monotonic() + 120, -1
    while (now := cpu_ticks(pid)) != before or "torch" not in Path(f"/proc/{pid}/maps").read_text():
        assert time.monotonic() < limit
        before = now
        time.sleep(1)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_worker_that_waits_takes_over_and_another_one_waits_then() -> None:
    spec = StreamSpec(job=TrainJob(synthetic=CLIP | {"frames": 10_000}, preset="live"))
    with running(Settings(), spec) as server:
        server.wait(lambda stream: stream["state"] == "live", seconds=120)
        stream = server.worker_stream()
        seen: set[int | None] = set()
        for epoch in (2, 3):
            first = stream.worker_pid
            limit = time.monotonic() + 60
            while not (waiting := {child.pid for child in multiprocessing.active_children()} - {first}):
                assert time.monotonic() < limit
                time.sleep(0.1)
            (spare,) = waiting
            assert spare is not None
            assert first is not None
            until_ready(spare)
            os.kill(first, signal.SIGKILL)
            shown = server.wait(lambda stream, epoch=epoch: stream["epoch"] == epoch)["version"]  # type: ignore[misc]
            assert stream.worker_pid == spare
            server.wait(lambda stream, shown=shown: stream["version"] > shown)  # type: ignore[misc]
            seen |= {first, spare}
    assert len(seen) == 3
    assert not [pid for pid in seen if Path(f"/proc/{pid}").exists()]
    assert not multiprocessing.active_children()
