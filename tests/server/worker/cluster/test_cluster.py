"""Streams trained by actors of a real Ray cluster on loopback: placed, refused, and moved when their node is killed."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Iterator

import pytest

pytest.importorskip("ray", reason="ray is missing: pip install 'streamlod[ray]'")

from server.pipeline.job import TrainJob
from server.pipeline.spec import StreamSpec
from server.settings import RaySettings, Settings, WorkerSettings
from tests.server.conftest import running, viewing
from tests.server.worker.cluster import brief
from tests.server.worker.cluster.nodes import Nodes, ray_nodes

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.filterwarnings("ignore::ResourceWarning"),  # of Ray's own files and processes
]
CLIP: dict[str, int | float | str | bool] = {"cameras": 3, "frames": 1000, "width": 64, "height": 36}
SOURCE = {"synthetic": CLIP, "preset": "live", "points": "random"}


@pytest.fixture(scope="module")
def nodes() -> Iterator[Nodes]:
    """Nodes of two and of one core."""
    with ray_nodes(2, 1) as found:
        yield found


def settings(nodes: Nodes, cpus: float) -> Settings:
    ray = RaySettings(address=nodes.address, cpus=cpus)
    return Settings(jobs="ray", ray=ray, worker=WorkerSettings(spare=False))


def test_a_stream_without_room_is_refused_with_what_would_have_to_stop(nodes: Nodes) -> None:
    with running(settings(nodes, 2)) as server, server.client(timeout=60) as client:
        assert client.post("/v1/streams", json={"id": "first", "start": True, **SOURCE}).status_code == 201
        refused = client.post("/v1/streams", json={"id": "second", "start": True, **SOURCE})
        assert refused.status_code == 409
        assert refused.json()["detail"].endswith("it needs 2 CPU on one node of the cluster, and none has them free; "
                                                 "stop first")  # fmt: skip
        assert [stream["id"] for stream in client.get("/v1/streams").json()["items"]] == ["first"]
        assert client.post("/v1/streams", json={"id": "second", **SOURCE}).status_code == 201
        assert client.post("/v1/streams/second/start").status_code == 409
        assert server.stream("second")["state"] == "failed"
        client.post("/v1/streams/first/stop")
        assert client.post("/v1/streams/second/start").status_code == 202
    with running(settings(nodes, 64)) as server, server.client(timeout=60) as client:
        refused = client.post("/v1/streams", json={"id": "large", "start": True, **SOURCE})
        assert (refused.status_code, "no node is that large" in refused.json()["detail"]) == (409, True)
    assert not multiprocessing.active_children()


def test_a_stream_goes_on_at_another_node_when_its_own_is_killed(nodes: Nodes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.stream.worker_stream.run_on_ray", brief.run_on_ray)
    spec = StreamSpec(job=TrainJob(synthetic=CLIP, preset="live", points="random"))
    with running(settings(nodes, 1), spec) as server, viewing(server) as viewer:
        viewer.hello()
        server.wait(lambda stream: stream["state"] == "live" and stream["version"] > 1, seconds=90)
        shown = server.stream()["version"]
        begin = time.monotonic()
        nodes.kill_worked_on()
        degraded = server.wait(lambda stream: stream["state"] == "degraded", seconds=10)
        assert "lost" in degraded["detail"]
        server.wait(lambda stream: stream["epoch"] == 2, seconds=60)
        print(f"a picture of the new epoch {time.monotonic() - begin:.1f} s after the kill")
        found = server.wait(lambda stream: stream["state"] == "live" and stream["version"] > shown + 1, seconds=60)
        assert (found["restarts"], nodes.actors()) == (1, 1)
        while not viewer.named("epoch") or min(viewer.decoder.versions) <= shown:
            viewer.step(20)
