"""Replays of the past, which only NATS has, while NATS is away."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

import pytest

pytest.importorskip("nats", reason="nats-py is missing: pip install 'streamlod[jetstream]'")

from streamlod.server.pipeline.spec import StreamSpec
from tests.codec.scenes import assert_same_state
from tests.server.conftest import Clip, Viewer, running, viewing
from tests.server.edge.jetstream.nats_servers import nats, needs_nats
from tests.waiting import wait

pytestmark = needs_nats
_READ_AHEAD = 2 * 16  # versions: what is being played and what is read next


def version_of(viewer: Viewer) -> int:
    return -1 if viewer.decoder.scene is None else viewer.decoder.scene.version


def follow(viewer: Viewer, seconds: float) -> list[int]:
    """Versions that come, until none has come for so long."""
    found, limit = list[int](), time.monotonic() + seconds
    while (left := limit - time.monotonic()) > 0:
        with suppress(TimeoutError):
            if isinstance(viewer.step(left), bytes):
                found.append(version_of(viewer))
                limit = time.monotonic() + seconds
    return found


def test_a_replay_waits_for_nats_and_a_seek_that_cannot_be_read_does_no_harm(long_clip: Clip, tmp_path: Path) -> None:
    with nats(tmp_path / "nats") as shared:
        spec, (server,) = StreamSpec(play=long_clip.path, loop=False), shared.servers
        with running(shared.settings(), spec) as publishing, running(shared.settings()) as late:
            publishing.wait(lambda stream: stream["state"] == "ended", seconds=40)
            wait(lambda: "main" in late.registry.streams)
            with viewing(late, max_queue=None) as viewer, late.client() as client:
                viewer.hello().until_version(399)

                viewer.send(type="seek", to={"epoch": 1, "version": 60})
                while version_of(viewer) != 80:  # from the keyframe at 50 on, then as fast as it was filmed
                    viewer.step()
                server.kill()
                stopped_at = follow(viewer, 3.0)[-1]
                assert 80 <= stopped_at <= 80 + _READ_AHEAD + 50  # 50 versions a second, until NATS was dead
                assert client.get("/v1/streams/main/packets/1/20").status_code == 503
                server.start()
                server.wait()
                viewer.next_packet()
                assert version_of(viewer) == stopped_at + 1  # where it stopped
                viewer.until_version(stopped_at + 20)

                server.kill()
                follow(viewer, 3.0)
                before = version_of(viewer)
                viewer.send(type="seek", to={"epoch": 1, "version": 210})
                place = viewer.until("position")
                assert (place["mode"], place["version"]) == ("replay", 210)
                found = follow(viewer, 3.5)  # longer than a request to JetStream is waited for
                assert (version_of(viewer), found) in ((before, []), (399, [350, 399]), (399, [399]))
                server.start()
                server.wait()
                wait(lambda: client.get("/v1/streams/main/manifest").status_code == 200)
                viewer.send(type="seek", to={"epoch": 1, "version": 310})
                while version_of(viewer) != 310:
                    viewer.step()
                assert viewer.decoder.scene is not None
                assert_same_state(viewer.decoder.scene, long_clip.states[310])
