"""Every kind of viewer over several refresh keyframes of 300 KB and more, which travel in pieces.

Over edges and NATS: `tests/server/edge/test_large_keyframes.py`; the page: `tests/client/web/test_large_keyframes.py`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import aclosing

import pytest

from streamlod.client.connection.link import WatchOptions
from streamlod.client.connection.watch import watch
from streamlod.client.events import NewScene
from streamlod.codec.packet.packet import PacketKind
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.codec.scenes import assert_same_level, assert_same_state
from tests.server.conftest import Clip, Running, running, viewing
from tests.server.large_clip import make_large_clip, see_keyframes
from tests.server.viewer.test_thin_session import ThinViewer

REFRESHES = 4  # keyframes after the first


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    return make_large_clip(tmp_path_factory.mktemp("large"))


@pytest.fixture(scope="module")
def server(large: Clip) -> Iterator[Running]:
    with running(Settings(), StreamSpec(play=large.path)) as server:
        server.wait(lambda stream: stream["state"] == "live")
        yield server


def test_a_viewer_that_decodes_has_every_state(server: Running, large: Clip) -> None:
    with viewing(server, max_queue=None) as viewer:
        see_keyframes(viewer, large, REFRESHES)


def test_a_viewer_with_fewer_levels_has_them(server: Running, large: Clip) -> None:
    with viewing(server, max_queue=None) as viewer:
        viewer.hello(levels=2).until("caught_up")
        for _ in range(3 * REFRESHES):
            viewer.next_packet()
            scene = viewer.decoder.scene
            assert scene is not None
            for level in range(2):
                assert_same_level(large.states[viewer.decoder.versions[level]].levels[level], scene.levels[level])


def test_the_python_client_gets_a_new_scene_with_each(server: Running, large: Clip) -> None:
    async def run() -> None:
        address = f"ws://127.0.0.1:{server.port}/v1/streams/main/live"
        async with aclosing(watch(address, WatchOptions(), attempts=1)) as events:
            found = 0
            async for event in events:
                if isinstance(event, NewScene) and event.levels == len(event.scene.levels):
                    assert_same_state(large.states[event.scene.version], event.scene)
                    found += event.info.kind is PacketKind.KEY
                if found > REFRESHES:
                    return

    asyncio.run(asyncio.wait_for(run(), 60))


def test_thin_viewers_get_pictures_over_all_of_them(server: Running, large: Clip) -> None:
    camera = large.states[0].header.cameras[0].scaled(96, 54)
    with viewing(server, max_queue=None) as one, viewing(server, max_queue=None) as two:
        viewers = [ThinViewer(plain.connection) for plain in (one, two)]
        for viewer in viewers:
            viewer.hello()
            viewer.look(camera)
        for _ in range(REFRESHES):
            for viewer in viewers:
                viewer.until("scene")
                viewer.picture()
