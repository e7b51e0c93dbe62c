"""Streams trained by actors of a real Ray cluster on loopback: placed, refused, and moved when their node is killed."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("ray", reason="ray is missing: pip install 'streamlod[ray]'")

from streamlod.client.evaluation.jobs import in_order
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import RaySettings, Settings, WorkerSettings
from tests.server.conftest import make_clip, running, viewing
from tests.server.worker.cluster import actors
from tests.server.worker.cluster.nodes import Nodes, ray_nodes

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.filterwarnings("ignore::ResourceWarning"),  # of Ray's own files and processes
]
KEY_EVERY = 10  # frames


@pytest.fixture(scope="module")
def nodes() -> Iterator[Nodes]:
    """Nodes of two and of one core."""
    with ray_nodes(2, 1) as found:
        yield found


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two minutes at two frames a second."""
    path = tmp_path_factory.mktemp("clip") / "clip.slod"
    return make_clip(path, 250, (5, 10), KEY_EVERY, frame_ns=500_000_000).path


def settings(nodes: Nodes, cpus: float, *, spare: bool = False) -> Settings:
    ray = RaySettings(address=nodes.address, cpus=cpus)
    return Settings(jobs="ray", ray=ray, worker=WorkerSettings(spare=spare))


@pytest.mark.timeout(400)
def test_a_stream_without_room_is_refused_with_what_would_have_to_stop(
    nodes: Nodes, clip: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("streamlod.server.stream.worker_stream.run_on_ray", actors.play_on_ray)
    monkeypatch.setattr("streamlod.server.stream.worker.placing._PLACING_SECONDS", 60.0)  # Ray may load slowly
    source = {"data": str(clip)}
    with running(settings(nodes, 2)) as server, server.client(timeout=90) as client:
        assert client.post("/v1/streams", json={"id": "first", "start": True, **source}).status_code == 201
        monkeypatch.setattr("streamlod.server.stream.worker_stream.run_on_ray", actors.play_on_ray_or_not)
        refused = client.post("/v1/streams", json={"id": "second", "start": True, **source})
        assert refused.status_code == 409
        assert refused.json()["detail"].endswith("it needs 2 CPU on one node of the cluster, and none has them free; "
                                                 "stop first")  # fmt: skip
        assert [stream["id"] for stream in client.get("/v1/streams").json()["items"]] == ["first"]
        assert client.post("/v1/streams", json={"id": "second", **source}).status_code == 201
        assert client.post("/v1/streams/second/start").status_code == 409
        assert server.stream("second")["state"] == "failed"
        with running(settings(nodes, 2), StreamSpec(job=TrainJob(data=clip))) as other:  # its stream waits for room
            other.wait(lambda stream: "none has them free" in stream["detail"] and stream["restarts"] > 1, seconds=90)
            assert other.stream()["state"] == "starting"
            client.post("/v1/streams/first/stop")
            other.wait(lambda stream: stream["state"] == "live", seconds=90)
        monkeypatch.setattr("streamlod.server.stream.worker_stream.run_on_ray", actors.play_on_ray)
        assert client.post("/v1/streams/second/start").status_code == 202
    monkeypatch.setattr("streamlod.server.stream.worker_stream.run_on_ray", actors.play_on_ray_or_not)
    with running(settings(nodes, 64)) as server, server.client(timeout=90) as client:
        refused = client.post("/v1/streams", json={"id": "large", "start": True, **source})
        assert (refused.status_code, "no node is that large" in refused.json()["detail"]) == (409, True)
    assert not multiprocessing.active_children()


def where(number: int, text: str) -> tuple[int, str, int]:
    """Stands in for a run of a study."""
    return number, text, os.getpid()


def test_runs_of_a_study_are_made_by_the_cluster_and_come_in_order(
    nodes: Nodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RAY_ADDRESS", nodes.address)
    runs = [(number, str(number)) for number in range(5)]
    found = list(in_order(where, runs, "ray"))
    assert [each[:2] for each in found] == runs == [each[:2] for each in in_order(where, runs)]
    assert os.getpid() not in {pid for *_, pid in found}


@pytest.mark.timeout(400)
def test_a_stream_goes_on_at_another_node_when_its_own_is_killed(
    nodes: Nodes, clip: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("streamlod.server.stream.worker_stream.run_on_ray", actors.play_on_ray)
    spec = StreamSpec(job=TrainJob(data=clip))
    with running(settings(nodes, 1, spare=True), spec) as server, viewing(server) as viewer:
        viewer.hello()
        server.wait(lambda stream: stream["state"] == "live", seconds=60)
        limit = time.monotonic() + 60
        while nodes.actors() != [1, 1]:  # one waits on the other node
            assert time.monotonic() < limit
            viewer.step()
        server.wait(
            lambda stream: stream["version"] > KEY_EVERY and 3 <= stream["version"] % KEY_EVERY <= 7, seconds=60
        )
        nodes.kill(nodes.oldest())
        viewer.until("epoch", 30)
        shown = max(viewer.decoder.versions)  # the last of the epoch before
        (degraded,) = [event["detail"] for event in viewer.named("state") if event["state"] == "degraded"]
        assert "was lost" in degraded
        viewer.next_packet()  # of a keyframe, or of its coarsest level
        assert viewer.decoder.scene is not None
        assert viewer.decoder.scene.keyframe == shown - shown % KEY_EVERY  # the last one
        found = server.wait(lambda stream: stream["state"] == "live" and stream["version"] > shown)
        assert (found["restarts"], found["epoch"]) == (1, 2)
    assert not multiprocessing.active_children()
