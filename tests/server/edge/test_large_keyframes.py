"""Refresh keyframes of 300 KB and more by way of an edge, to a viewer that decodes and a thin one."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import EdgeSettings, Settings
from tests.codec.scenes import assert_same_state
from tests.server.conftest import Clip, Running, running, viewing
from tests.server.large_clip import make_large_clip
from tests.server.viewer.test_thin_session import ThinViewer
from tests.waiting import wait

pytestmark = pytest.mark.cluster
REFRESHES = 3


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    return make_large_clip(tmp_path_factory.mktemp("large"))


@pytest.fixture(scope="module")
def edge(large: Clip) -> Iterator[Running]:
    with running(Settings(), StreamSpec(play=large.path)) as origin:
        origin.wait(lambda stream: stream["state"] == "live")
        known = EdgeSettings(origin=origin.url, poll_seconds=0.1)
        with running(Settings(edge=known)) as edge:
            yield edge


def watch_large(server: Running, large: Clip) -> None:
    """A viewer that decodes and a thin one, over `REFRESHES` keyframes."""
    wait(lambda: "main" in server.registry.streams)
    camera = large.states[0].header.cameras[0].scaled(96, 54)
    with viewing(server, max_queue=None) as viewer, viewing(server, max_queue=None) as plain:
        thin = ThinViewer(plain.connection)
        thin.hello()
        thin.look(camera)
        viewer.hello().until("caught_up")
        keyframes: set[tuple[int, int]] = set()
        while len(keyframes) <= REFRESHES:
            viewer.step()
            scene = viewer.decoder.scene
            if scene is not None and len(set(viewer.decoder.versions)) == 1:
                keyframes.add((len(viewer.named("epoch")), scene.keyframe))
                assert_same_state(large.states[scene.version], scene)
        for _ in range(REFRESHES):
            thin.until("scene")
            thin.picture()


def test_an_edge_passes_them_on(edge: Running, large: Clip) -> None:
    watch_large(edge, large)
