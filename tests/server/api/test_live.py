"""The live websocket: joining, leaving out, seeking, faults. A decoded frame always equals the sequential decode."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed

from streamlod.codec.packet.info import peek
from streamlod.codec.packet.packet import PacketKind
from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Limits, Settings
from tests.codec.scenes import assert_same_level, assert_same_state
from tests.server.conftest import UNWATCHED, Clip, Running, Viewer, make_clip, running, viewing

PIECE = 32_768  # bytes of a keyframe in one websocket frame
LIMITS = Limits(messages_per_second=20, viewer_lag_seconds=30)


@pytest.fixture(scope="module")
def server(clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    state = tmp_path_factory.mktemp("state")
    with running(Settings(state=state, limits=LIMITS), StreamSpec(play=clip.path)) as server:
        server.wait(lambda stream: stream["state"] == "live")
        yield server


@contextmanager
def watching(server: Running) -> Iterator[Viewer]:
    """A viewer that has said hello; it comes when the stream is live: a hello is not waited for as long as a worker."""
    server.wait(lambda stream: stream["state"] == "live")
    with viewing(server) as viewer:
        yield viewer.hello()


def check(viewer: Viewer, clip: Clip) -> None:
    """The viewer's state is that of the sequential decode at its version."""
    scene = viewer.decoder.scene
    assert scene is not None
    assert_same_state(clip.states[scene.version], scene)


def test_joins_coarse_first_and_follows_every_frame(server: Running, clip: Clip) -> None:
    with viewing(server) as viewer:
        viewer.hello()
        assert viewer.until("position")["mode"] == "live"
        viewer.next_packet()
        assert viewer.decoder.versions[1:] == (-1, -1)  # the coarse level alone makes the first picture
        viewer.until("caught_up")
        check(viewer, clip)
        seen = []
        for _ in range(30):
            if isinstance(viewer.step(), bytes) and len(set(viewer.decoder.versions)) == 1:
                seen.append(viewer.decoder.versions[0])
                check(viewer, clip)
        assert len(seen) > 15
        assert all(later in {earlier + 1, 0, 60} for earlier, later in itertools.pairwise(seen))


@pytest.mark.long
@pytest.mark.parametrize(("frame_ns", "key_every", "lag_seconds"), [(20_000_000, 20, 30.0), (1_000_000_000, 4, 3.0)])
def test_a_new_keyframe_comes_in_pieces_and_no_version_is_lost(
    tmp_path: Path, frame_ns: int, key_every: int, lag_seconds: float
) -> None:
    """No burst at the live edge: one message of many frames, then every version that has come since.

    With a frame a second, a piece in a frame's time would take longer than the viewer may lag.
    """
    counts, limits = (200, 600, 2500), Limits(viewer_lag_seconds=lag_seconds)
    clip = make_clip(tmp_path / "scene.slod", 4 * key_every, counts=counts, key_every=key_every, frame_ns=frame_ns)
    with running(Settings(limits=limits), StreamSpec(play=clip.path)) as server, viewing(server) as viewer:
        viewer.hello().until("caught_up")
        renewed, followed, version = 0, 0, viewer.decoder.versions[0]
        while renewed < 2 or followed < 3:
            parts = [part for part in viewer.connection.recv_streaming() if isinstance(part, bytes)]
            if not parts:  # an event
                continue
            packet = b"".join(parts)
            info = peek(packet)
            viewer.decoder.push(packet)
            if info.kind is PacketKind.KEY:
                renewed, followed = renewed + 1, 0
                assert len(packet) > 3 * PIECE
                assert [len(part) for part in parts] == [PIECE] * (len(packet) // PIECE) + [len(packet) % PIECE]
                assert info.to_version in {version, version + 1, 0}
            else:
                followed += 1
                assert info.to_version == version + 1
                assert len(set(viewer.decoder.versions)) == 1
                check(viewer, clip)
            version = info.to_version


def test_fewer_levels_are_sent_on_request_and_come_back(server: Running, clip: Clip) -> None:
    with viewing(server) as viewer:
        viewer.hello(levels=1)
        viewer.until("caught_up")
        assert viewer.decoder.versions[1:] == (-1, -1)
        viewer.send(type="set", levels=3)
        while not viewer.named("levels") or viewer.named("levels")[-1]["levels"] < 3:
            viewer.step()
        while len(set(viewer.decoder.versions)) > 1:
            viewer.step()
        check(viewer, clip)
        viewer.send(type="set", levels=2)
        assert viewer.until("levels")["reason"] == "requested"
        at = viewer.decoder.versions[2]
        while viewer.decoder.versions[0] < at + 3 and viewer.decoder.versions[0] >= at:
            viewer.step()
        scene = viewer.decoder.scene
        assert scene is not None
        for number in (0, 1):
            assert_same_level(clip.states[viewer.decoder.versions[number]].levels[number], scene.levels[number])


def test_seeks_back_pauses_and_returns(server: Running, clip: Clip) -> None:
    server.wait(lambda stream: stream["epoch"] >= 2)
    with viewing(server) as viewer:
        viewer.hello()
        viewer.until("caught_up")
        viewer.send(type="seek", to={"epoch": 1, "version": 70})
        while True:
            if (place := viewer.until("position"))["mode"] == "replay":
                break
        assert (place["epoch"], place["version"], place["clamped"]) == (1, 70, False)
        for _ in range(5):
            viewer.next_packet()
        check(viewer, clip)
        viewer.send(type="pause")
        paused = viewer.until("position")
        assert paused["mode"] == "paused"
        viewer.send(type="play")
        assert viewer.until("position")["version"] == paused["version"]
        viewer.send(type="seek", to={"epoch": 0, "version": 5})
        clamped = viewer.until("position")
        assert clamped["clamped"]
        assert (clamped["epoch"], clamped["version"]) == (1, 0)
        viewer.send(type="seek", to="live")
        assert viewer.until("position")["mode"] == "live"
        viewer.until("caught_up")
        check(viewer, clip)


def test_a_hello_may_start_in_the_past(server: Running, clip: Clip) -> None:
    with viewing(server) as viewer:
        viewer.hello(start={"epoch": 1, "version": 3})
        place = viewer.until("position")
        assert place == {"type": "event", "event": "position", "mode": "replay", "epoch": 1, "version": 3,
                         "clamped": False}  # fmt: skip
        while not viewer.decoder.versions or viewer.decoder.versions[0] < 8:
            viewer.step()
        check(viewer, clip)


def closed(viewer: Viewer) -> tuple[int, str]:
    """Close code and reason, after taking everything that comes before."""
    with pytest.raises(ConnectionClosed) as caught:
        viewer.until("nothing that the server sends")
    assert caught.value.rcvd is not None
    return caught.value.rcvd.code, caught.value.rcvd.reason


def test_a_viewer_of_later_versions_too_is_answered_with_one_in_common(server: Running, clip: Clip) -> None:
    """Version 1 of the protocol carries packets of version 1 of the format, whatever else the viewer could read."""
    with viewing(server) as viewer:
        assert viewer.hello(versions=[2, 1, 99]).welcome["version"] == 1
        while not isinstance(packet := viewer.step(), bytes):
            pass
        assert packet[:5] == b"SLPK\1"
        viewer.until("caught_up")
        check(viewer, clip)


def test_who_says_no_hello_is_shown_out() -> None:
    limits = Limits(hello_seconds=0.4)
    with running(Settings(limits=limits), UNWATCHED) as server, viewing(server) as viewer:
        assert closed(viewer) == (4408, "no hello within 0.4 s")


def test_protocol_faults_close_with_their_code(server: Running) -> None:
    for text, code in (
        ("{", 4400),
        ("[]", 4400),
        ('{"type":"ack","bytes":1}', 4400),
        ('{"type":"hello","versions":[7]}', 4415),
        ('{"type":"hello","versions":[1],"levels":0}', 4400),
        ('{"type":"hello","versions":[1],"start":{"epoch":-1,"version":0}}', 4400),
    ):
        with viewing(server) as viewer:
            viewer.connection.send(text)
            assert closed(viewer)[0] == code, text
    with viewing(server) as viewer:
        viewer.hello().connection.send(b"binary")
        assert closed(viewer)[0] == 4400
    with viewing(server) as viewer:
        viewer.hello().connection.send("x" * 5000)
        assert closed(viewer)[0] == 1009
    with viewing(server, "nobody") as viewer:
        assert closed(viewer)[0] == 4404
    with viewing(server, subprotocols=None) as viewer:
        assert closed(viewer)[0] == 4415
    with viewing(server, additional_headers={"Origin": "https://elsewhere.example"}) as viewer:
        assert closed(viewer)[0] == 4403
    with viewing(server) as viewer:
        viewer.hello()
        with contextlib.suppress(ConnectionClosed):
            for _ in range(200):  # many seconds' worth; without end, they would be in the way of the server's close
                viewer.send(type="pause")
        assert closed(viewer)[0] == 4429
    assert server.stream()["state"] == "live"


def test_worker_killed_in_mid_frame_is_replaced_and_viewers_stay(slow_clip: Clip, tmp_path: Path) -> None:
    with running(Settings(state=tmp_path), StreamSpec(play=slow_clip.path)) as server, watching(server) as viewer:
        viewer.until("caught_up")
        pid = server.worker_stream().worker_pid
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        assert viewer.until("state")["state"] == "degraded"
        assert viewer.until("epoch")["epoch"] == 2
        viewer.step()
        while len(set(viewer.decoder.versions)) > 1:
            viewer.step()
        check(viewer, slow_clip)
        found = server.wait(lambda stream: stream["state"] == "live")
        assert (found["restarts"], found["epoch"]) == (1, 2)


def test_a_deleted_stream_closes_its_viewers(clip: Clip) -> None:
    with running(Settings(), StreamSpec(play=clip.path)) as server, watching(server) as viewer:
        with server.client() as client:
            assert client.delete("/v1/streams/main").status_code == 204
        assert closed(viewer)[0] == 1000


def test_stopping_the_server_tells_viewers_to_come_back(clip: Clip) -> None:
    with running(Settings(), StreamSpec(play=clip.path)) as server, watching(server) as viewer:
        server.registry.draining = True
        for session in server.registry.sessions:
            session.end(SessionError(CloseCode.STOPPING, "the server is stopping"))
        assert closed(viewer)[0] == 1001
        with server.client() as client:
            assert client.get("/readyz").status_code == 503
