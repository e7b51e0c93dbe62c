"""How long a stream stands still when the node of its worker is killed: a real Ray cluster on loopback, one viewer.

    python -m tests.bench.ray_bench [--kills 3 --pause 20 --no-spare]

Three nodes of one core each, of which the one that trains loses all its processes at once, as with its machine. Prints
seconds from the kill to the event that tells of it, to the first whole picture of the new epoch in the viewer's
decoder, and to the next version that was trained after it. The first frame is trained for a few steps only.
"""

from __future__ import annotations

import argparse
import time

import pytest

from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import RaySettings, Settings, WorkerSettings
from tests.server.conftest import Viewer, running, viewing
from tests.server.worker.cluster import actors
from tests.server.worker.cluster.nodes import Nodes, ray_nodes

_CLIP: dict[str, int | float | str | bool] = {"cameras": 4, "frames": 100_000, "width": 160, "height": 90}
_MAX_SECONDS = 300.0


def until_version(viewer: Viewer, version: int) -> None:
    """Step until the picture is whole and of at least `version`."""
    while not viewer.decoder.versions or min(viewer.decoder.versions) < version:
        viewer.step(_MAX_SECONDS)


def watch(nodes: Nodes, viewer: Viewer, number: int, pause_seconds: float, *, spare: bool) -> None:
    """Kill the node that trains, and print what the viewer saw."""
    ready = time.monotonic() + pause_seconds
    while time.monotonic() < ready or sum(nodes.actors()) < 1 + spare:
        viewer.step(_MAX_SECONDS)
    epochs = len(viewer.named("epoch"))
    begin = time.monotonic()
    nodes.kill(nodes.oldest())
    viewer.until("state", _MAX_SECONDS)
    told = time.monotonic() - begin
    while len(viewer.named("epoch")) == epochs:
        viewer.step(_MAX_SECONDS)
    viewer.next_packet()
    until_version(viewer, 0)
    shown, version = time.monotonic() - begin, max(viewer.decoder.versions)
    until_version(viewer, version + 1)
    going = time.monotonic() - begin
    print(f"{number}: told after {told:.2f} s, a picture after {shown:.2f} s, the next version after {going:.2f} s")
    nodes.add(1)


def main() -> None:
    """Kill one node after the other."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--kills", type=int, default=3)
    parser.add_argument("--pause", type=float, default=20.0)
    parser.add_argument("--no-spare", action="store_true")
    options = parser.parse_args()
    spare = not options.no_spare
    spec = StreamSpec(job=TrainJob(synthetic=_CLIP, preset="live", points="random"))
    with ray_nodes(1, 1, 1) as nodes, pytest.MonkeyPatch.context() as patch:
        patch.setattr("streamlod.server.stream.worker_stream.run_on_ray", actors.train_on_ray)
        ray = RaySettings(address=nodes.address)
        settings = Settings(jobs="ray", ray=ray, worker=WorkerSettings(spare=spare))
        with running(settings, spec) as server, viewing(server) as viewer:
            viewer.hello()
            server.wait(lambda stream: stream["state"] == "live", seconds=_MAX_SECONDS)
            for number in range(options.kills):
                watch(nodes, viewer, number + 1, options.pause, spare=spare)


if __name__ == "__main__":
    main()
