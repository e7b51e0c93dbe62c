"""Recordings of a live stream: how many pictures, at which rate, and what they show."""

from __future__ import annotations

import asyncio
import json
import signal
import ssl
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from websockets.asyncio.server import ServerConnection, serve
from websockets.sync.server import ServerConnection as SyncConnection
from websockets.sync.server import serve as serve_in_threads

from streamlod.client.commands import view
from streamlod.client.connection.link import SUBPROTOCOL, WatchOptions
from streamlod.client.viewing.record import record_stream
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.packet.levels import split_levels
from streamlod.core.arrays import UInt8
from streamlod.core.errors import FilmCutShort, InputError, SessionError
from streamlod.core.render.splatter import draw_cloud
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from streamlod.core.scene.interpolate import interpolate
from streamlod.core.scene.residual import difference
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.service.self_signed import write_self_signed
from streamlod.server.settings import Settings
from tests.client.clips import packets
from tests.client.test_playback import WELCOME
from tests.client.web.scenes import make_scene, moved
from tests.server.conftest import make_clip, running
from tests.server.sounds import hear, pieces
from tests.small_disk import mounted_disk
from tests.waiting import PATIENCE, wait

FPS = 10.0


def states(count: int) -> list[Scene]:
    """A scene in which something turns, at ten frames a second."""
    scene = make_scene(200, view_dependent=False)
    found = [replace(scene, header=replace(scene.header, fps=FPS))]
    while len(found) < count:
        found.append(moved(found[-1]))
    return found


def recorded(
    data: list[bytes],
    out: Path,
    frames: int | None = None,
    fps: float | None = None,
    secure: ssl.SSLContext | None = None,
    end: tuple[int, str] = (1000, ""),
    joined: int = 0,
) -> int:
    """Record a stream of these packets, of which the first `joined` lead to the live edge, from its middle camera;
    returns the number of pictures.
    """

    async def stream(socket: ServerConnection) -> None:
        await socket.recv()
        await socket.send(json.dumps(WELCOME))
        for packet in data[:joined]:
            await socket.send(packet)
        await socket.send(json.dumps({"type": "event", "event": "caught_up"}))
        for packet in data[joined:]:
            await socket.send(packet)
        await socket.close(*end)

    async def run() -> int:
        offered: list[Any] = [SUBPROTOCOL]
        async with serve(stream, "127.0.0.1", 0, subprotocols=offered, compression=None, ssl=secure) as server:
            url = f"ws{'s' if secure else ''}://127.0.0.1:{server.sockets[0].getsockname()[1]}/v1/streams/main/live"
            return await record_stream(url, out, lambda header: lambda number: header.cameras[2], frames, fps=fps)

    return asyncio.run(run())


def shown(folder: Path) -> list[UInt8]:
    """The pictures of a folder, RGB."""
    return [np.asarray(cv2.imread(str(path))[..., ::-1], np.uint8) for path in sorted(folder.glob("*.png"))]


def drawn(scene: Scene, after: Scene | None = None, share: float = 0) -> UInt8:
    """The middle camera's picture of a state, or of what lies between two."""
    camera = scene.header.cameras[2]
    cloud = expand(scene, camera.centre) if after is None else interpolate(scene, after, share, camera.centre)
    return draw_cloud(cloud, camera, scene.header.background)


def test_the_first_picture_has_all_levels(tmp_path: Path) -> None:
    scenes = states(2)
    key, residual = packets(scenes)
    assert recorded([*split_levels(key), residual], tmp_path / "seen") == 2
    for picture, scene in zip(shown(tmp_path / "seen"), scenes, strict=True):
        np.testing.assert_array_equal(picture, drawn(scene))


def test_a_live_film_begins_live(tmp_path: Path) -> None:
    """A keyframe of minutes ago, which a stream is joined by, is no part of it."""
    scenes = states(4)
    assert recorded(packets(scenes), tmp_path / "seen", joined=3) == 2
    for picture, scene in zip(shown(tmp_path / "seen"), scenes[2:], strict=True):
        np.testing.assert_array_equal(picture, drawn(scene))


def test_a_stream_that_ends_before_all_levels_came_is_still_seen(tmp_path: Path) -> None:
    coarse, *_ = split_levels(packets(states(1))[0])
    assert recorded([coarse], tmp_path / "seen") == 1


@pytest.mark.parametrize(
    ("start", "state"), [((1, 0), "degraded"), ((1, 0), "starting"), ((1, 0), "idle"), (None, "degraded")]
)
def test_what_a_server_has_kept_ends_where_no_camera_films(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    start: tuple[int, int] | None,
    state: str,
) -> None:
    """A film of it all is whole then. Who watches live waits for the cameras instead, here until the server ends."""
    monkeypatch.setattr("streamlod.client.viewing.record._GONE_SECONDS", 0.5)
    data, is_gone = packets(states(4)), "camera phone1 is lost"

    async def stream(socket: ServerConnection) -> None:
        await socket.recv()
        await socket.send(json.dumps(WELCOME | {"state": "live"}))
        for packet in data[:3]:
            await socket.send(packet)
        await socket.send(json.dumps({"type": "event", "event": "caught_up"}))
        await socket.send(json.dumps({"type": "event", "event": "state", "state": state, "detail": is_gone}))
        if start is None:
            await asyncio.sleep(1)  # more than would end it
            await socket.send(data[3])
            await socket.close(1000)
        await socket.wait_closed()

    async def run() -> int:
        async with serve(stream, "127.0.0.1", 0, subprotocols=[SUBPROTOCOL], compression=None) as server:
            url = f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}/v1/streams/main/live"
            options = WatchOptions(start=start)
            return await record_stream(url, tmp_path / "out", lambda header: lambda _: header.cameras[2], None, options)

    assert asyncio.run(run()) == (2 if start is None else 3)
    assert (is_gone in caplog.text) == (start is not None)


def test_a_live_film_ends_by_ctrl_c_with_its_sound(tmp_path: Path) -> None:
    """A stream that goes on tells no end."""
    film, clip = tmp_path / "evening.mp4", make_clip(tmp_path / "clip.slod", 400, frame_ns=100_000_000)
    with running(Settings(), StreamSpec(play=clip.path, loop=False)) as server:
        hear(server, pieces(42.0))
        command = [sys.executable, "-m", "streamlod.server.cli", "view", server.url, "--out", str(film)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            try:
                wait(lambda: any(part.stat().st_size > 0 for part in tmp_path.glob("*evening*")))  # a picture is in it
                begun = server.stream()["version"]
                server.wait(lambda stream: stream["version"] >= begun + 25)
                process.send_signal(signal.SIGINT)
                told, _ = process.communicate(timeout=PATIENCE)
            finally:
                process.kill()
    assert process.returncode == 0
    with av.open(str(film)) as found:
        assert told == f"{len(list(found.decode(video=0)))} pictures in {film}\n"
        found.seek(0)
        assert max(np.abs(sound.to_ndarray()).max() for sound in found.decode(audio=0)) > 0.1


def test_who_may_not_watch_any_more_keeps_the_film(tmp_path: Path) -> None:
    """As where a token runs out in the evening; the error says so, and where the pictures are."""
    end = (4401, "the token has expired or was withdrawn; connect with another")
    with pytest.raises(FilmCutShort, match=r"the token has expired .* 3 pictures") as caught:
        recorded(packets(states(3)), tmp_path / "a.mp4", end=end)
    assert isinstance(caught.value.__cause__, SessionError)
    with av.open(str(tmp_path / "a.mp4")) as film:
        assert len(list(film.decode(video=0))) == 3
    with pytest.raises(SessionError, match="the token has expired"):
        recorded([], tmp_path / "b.mp4", end=end)
    assert not (tmp_path / "b.mp4").exists()


def test_a_disk_that_gets_full_keeps_the_film(tmp_path: Path) -> None:
    with mounted_disk(tmp_path / "disk") as disk:
        (disk / "other").write_bytes(bytes(3_000_000))
        with pytest.raises(FilmCutShort, match=r"a\.mp4: cannot be written any more .*disk is full") as caught:
            recorded(packets(states(80)), disk / "a.mp4")
        with av.open(str(disk / "a.mp4")) as film:
            assert len(list(film.decode(video=0))) == caught.value.kept > 0


@pytest.mark.parametrize("missing", ["pydantic", "nothing"])
def test_a_stream_that_is_not_there_is_refused_also_where_nobody_tells_what_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    """By an image without REST, and by a server that answers no question."""
    monkeypatch.setitem(sys.modules, missing, None)
    for name in ("rest", "rest_answers"):
        monkeypatch.delitem(sys.modules, f"streamlod.client.{name}", raising=False)

    def refuse(socket: SyncConnection) -> None:
        socket.recv()
        socket.close(4404, "there is no such stream")

    with serve_in_threads(refuse, "127.0.0.1", 0, subprotocols=[SUBPROTOCOL], compression=None) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        address = f"http://127.0.0.1:{server.socket.getsockname()[1]}"
        with pytest.raises(SessionError, match=r"there is no such stream \[4404\]$"):
            view(address, tmp_path / "out", orbiting=True)
        server.shutdown()
        thread.join(60)


def test_a_picture_for_each_state(tmp_path: Path) -> None:
    scenes = states(4)
    assert recorded(packets(scenes), tmp_path / "out") == 4
    for picture, scene in zip(shown(tmp_path / "out"), scenes, strict=True):
        np.testing.assert_array_equal(picture, drawn(scene))


def test_a_certificate_of_a_rigs_own_making_is_trusted_where_it_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    certificate, key = tmp_path / "rig-certificate.pem", tmp_path / "rig-key.pem"
    write_self_signed(certificate, key, "127.0.0.1")
    secure = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    secure.load_cert_chain(certificate, key)
    data = packets(states(2))
    with pytest.raises(InputError, match=r"is not trusted .self-signed.*set SSL_CERT_FILE=rig-certificate\.pem"):
        recorded(data, tmp_path / "none", secure=secure)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    assert recorded(data, tmp_path / "film", secure=secure) == 2


def test_a_film_of_a_higher_rate_shows_what_lies_between(tmp_path: Path) -> None:
    scenes = states(3)
    assert recorded(packets(scenes), tmp_path / "out", fps=40) == 9
    pictures = shown(tmp_path / "out")
    for number, scene in enumerate(scenes):
        np.testing.assert_array_equal(pictures[4 * number], drawn(scene))
    for number, share in ((1, 0.25), (2, 0.5), (3, 0.75)):
        np.testing.assert_array_equal(pictures[number], drawn(scenes[0], scenes[1], share))
    assert np.abs(pictures[2].astype(int) - pictures[0]).max() > 8


@pytest.mark.parametrize(("fps", "count"), [(60.0, 31), (25.0, 13), (5.0, 3)])
def test_a_film_lasts_as_long_as_the_stream(tmp_path: Path, fps: float, count: int) -> None:
    assert recorded(packets(states(6)), tmp_path / "a.mp4", fps=fps) == count
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        assert float(stream.average_rate or 0) == fps
        assert len(list(container.decode(stream))) == count


def test_a_film_of_a_stream_that_leaves_instants_out_lasts_as_long_as_they(tmp_path: Path) -> None:
    """At 10 frames a second, states of 0, 1 and 1.1 s; a folder has each once."""
    first, second, third = states(3)
    assert first.header.fps == 10
    data = [encode_keyframe(first, time_ns=0, profile=0)]
    for before, after, time_ns in ((first, second, 10**9), (second, third, 11 * 10**8)):
        data.append(encode_residual(before, difference(before, after), time_ns=time_ns, profile=0))
    assert recorded(data, tmp_path / "a.mp4") == 12
    assert recorded(data, tmp_path / "out") == 3
    assert recorded(data, tmp_path / "at a rate", fps=FPS) == 12
    np.testing.assert_array_equal(shown(tmp_path / "at a rate")[5], drawn(first, second, 0.5))


def test_a_film_ends_at_the_pictures_that_are_wanted(tmp_path: Path) -> None:
    assert recorded(packets(states(4)), tmp_path / "out", frames=6, fps=40) == 6


def test_before_a_keyframe_the_state_is_held(tmp_path: Path) -> None:
    """Its rows are other anchors: nothing lies between. Nor where a connection begins again with an older state."""
    first, second, third = states(3)
    renewed = replace(make_scene(150, view_dependent=False), header=first.header, keyframe=3, version=3, identifier=1)
    data = [*packets([first, second, third]), encode_keyframe(renewed, time_ns=0), encode_keyframe(first, time_ns=0)]
    assert recorded(data, tmp_path / "out", fps=20) == 9
    pictures = shown(tmp_path / "out")
    for number, scene in ((4, third), (5, third), (6, renewed), (7, renewed), (8, first)):
        np.testing.assert_array_equal(pictures[number], drawn(scene))
