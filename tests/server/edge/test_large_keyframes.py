"""Refresh keyframes of 300 KB and more by way of an edge, to a viewer that decodes and a thin one."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import EdgeSettings, Settings
from tests.server.conftest import Clip, Running, running, viewing
from tests.server.large_clip import make_large_clip, see_keyframes
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
        see_keyframes(viewer, large, REFRESHES)
        for _ in range(REFRESHES):
            thin.until("scene")
            thin.picture()


def test_an_edge_passes_them_on(edge: Running, large: Clip) -> None:
    watch_large(edge, large)
