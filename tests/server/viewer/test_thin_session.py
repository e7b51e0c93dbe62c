"""Viewers for which the server draws: the same pictures as elsewhere, one on its way at a time, within limits."""

from __future__ import annotations

import contextlib
import json
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from prometheus_client import generate_latest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection

from streamlod.core.camera import Camera
from streamlod.core.errors import SessionError
from streamlod.core.render.splatter import Splatter
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.gaussians import GaussianCloud
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.protocol.messages import parse_control, parse_hello
from streamlod.server.protocol.thin_messages import ViewMessage
from streamlod.server.service.metrics import collector_registry
from streamlod.server.settings import Limits, Settings
from streamlod.server.viewer.grades import GRADES, GradeControl
from streamlod.server.viewer.renderer import HEADER, draw, fitted
from tests.client.web.miniserver import make_clip
from tests.client.web.scenes import make_scene
from tests.server.conftest import Running, running, viewing

FRAMES = 12


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One message, taken apart."""

    number: int
    version: int
    quality: int
    image: np.ndarray  # [H,W,3] uint8 RGB


@dataclass(slots=True)
class ThinViewer:
    """A viewer without a decoder."""

    connection: ClientConnection
    events: list[dict[str, Any]] = field(default_factory=list)

    def send(self, **message: Any) -> None:
        self.connection.send(json.dumps(message))

    def look(self, camera: Camera) -> None:
        self.send(type="view", **view_of(camera))

    def hello(self, **fields: Any) -> dict[str, Any]:
        """Say hello; the scene event."""
        self.send(type="hello", versions=[1], client="thin/1", pictures=True, **fields)
        return self.until("scene")

    def until(self, name: str) -> dict[str, Any]:
        """The next event of that name; pictures that come before it are acknowledged."""
        while True:
            message = self.connection.recv(60)
            if isinstance(message, bytes):
                self._acknowledge(message)
                continue
            self.events.append(json.loads(message))
            if self.events[-1].get("event") == name:
                return self.events[-1]

    def _acknowledge(self, message: bytes) -> None:
        self.send(type="ack", picture=HEADER.unpack_from(message)[0])

    def picture(self) -> Picture:
        """The next picture, acknowledged."""
        while isinstance(message := self.connection.recv(60), str):
            self.events.append(json.loads(message))
        number, _, version, width, height, quality, _, _, _ = HEADER.unpack_from(message)
        image = cv2.imdecode(np.frombuffer(message, np.uint8, offset=HEADER.size), cv2.IMREAD_COLOR_RGB)
        assert image.shape == (height, width, 3)
        self._acknowledge(message)
        return Picture(number, version, quality, image)

    def best(self, version: int) -> Picture:
        """Pictures until the finest of a version."""
        while (picture := self.picture()).version != version or picture.quality != GRADES[0].quality:
            pass
        return picture


def view_of(camera: Camera) -> dict[str, Any]:
    k = camera.intrinsics
    return {
        "width": camera.width, "height": camera.height, "rotation": camera.world_to_camera[:3, :3].ravel().tolist(),
        "position": camera.centre.tolist(), "focal": [k[0, 0], k[1, 1]], "principal": [k[0, 2], k[1, 2]],
    }  # fmt: skip


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a.astype(np.float64) - b) ** 2) / 255**2))


@pytest.fixture(scope="module")
def states(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Scene]]:
    clip = make_clip(make_scene(300, view_dependent=False), FRAMES)
    path = tmp_path_factory.mktemp("thin") / "clip.slod"
    clip.write(path)
    return path, clip.states


@pytest.fixture(scope="module")
def server(states: tuple[Path, list[Scene]]) -> Iterator[Running]:
    limits = Limits(thin_viewers=2, thin_pixels=160_000)
    with running(Settings(limits=limits), StreamSpec(play=states[0], loop=False)) as server:
        server.wait(lambda stream: stream["state"] == "ended")
        yield server


def test_draws_what_the_client_draws(server: Running, states: tuple[Path, list[Scene]]) -> None:
    scene = states[1][-1]
    with viewing(server) as plain:
        viewer = ThinViewer(plain.connection)
        facts = viewer.hello()
        assert [camera["name"] for camera in facts["cameras"]] == [camera.name for camera in scene.header.cameras]
        assert facts["levels"] == 3
        for number in (0, 3):
            camera = scene.header.cameras[number]
            viewer.look(camera)
            picture = viewer.best(FRAMES - 1)
            assert psnr(picture.image, Splatter().picture(scene, camera)) >= 35
    assert viewer.events[0]["type"] == "welcome"


def test_seeks_and_answers_about_rays(server: Running, states: tuple[Path, list[Scene]]) -> None:
    scene = states[1][4]
    camera = scene.header.cameras[2]
    with viewing(server) as plain:
        viewer = ThinViewer(plain.connection)
        viewer.hello()
        viewer.look(camera)
        viewer.send(type="pause")
        viewer.send(type="seek", to={"epoch": 1, "version": 4})
        viewer.until("position")
        while viewer.picture().version < 4:
            pass
        viewer.send(type="pause")
        cloud = Splatter().cloud(scene, camera)
        away = cloud.means[int(cloud.opacities.argmax())] - camera.centre
        viewer.send(type="pick", id=7, origin=camera.centre.tolist(), direction=(away / np.linalg.norm(away)).tolist())
        answer = viewer.until("picked")
        assert answer["id"] == 7
        assert 1 < answer["depth"] < 8
        assert answer["point"] is not None
        along = (np.array(answer["point"]) - camera.centre) / away
        assert np.allclose(along, along[0])
        assert 0 < along[0] < 1.0001


def test_a_seek_shows_its_place_and_nothing_on_the_way(server: Running, states: tuple[Path, list[Scene]]) -> None:
    """Playing or paused, the first picture after the answer is that of the frame that was sought, and of the newest
    seek where several come at once."""
    with viewing(server) as plain:
        viewer = ThinViewer(plain.connection)
        viewer.hello()
        viewer.look(states[1][-1].header.cameras[2])
        viewer.best(FRAMES - 1)
        for version, fields in ((9, {}), (3, {}), (8, {"stop": True}), (2, {"stop": True})):
            viewer.send(type="seek", to={"epoch": 1, "version": version}, **fields)
            while viewer.until("position")["version"] != version:
                pass
            assert viewer.picture().version == version
        for version in (10, 4, 7):
            viewer.send(type="seek", to={"epoch": 1, "version": version}, stop=True)
        while viewer.until("position")["mode"] != "paused":
            pass
        assert viewer.best(7).version == 7
        viewer.send(type="seek", to={"epoch": 1, "version": 5})
        viewer.send(type="pause")
        while viewer.until("position")["mode"] != "paused":
            pass
        assert viewer.best(5).version == 5


def test_one_picture_on_its_way_and_the_newest_view_wins(server: Running, states: tuple[Path, list[Scene]]) -> None:
    cameras = states[1][-1].header.cameras
    with viewing(server) as plain:
        viewer = ThinViewer(plain.connection)
        viewer.hello()
        viewer.look(cameras[0])
        message: Any = ""
        while isinstance(message, str):
            message = viewer.connection.recv(60)
        for camera in (*cameras, *cameras[:4]):
            viewer.look(camera)
        with contextlib.suppress(TimeoutError):
            while isinstance(viewer.connection.recv(0.6), str):
                pass
            pytest.fail("a second picture came before the first was acknowledged")
        viewer.send(type="ack", picture=1)
        picture = viewer.picture()
        assert picture.number == 2
        expected = cv2.resize(Splatter().picture(states[1][-1], cameras[3]), picture.image.shape[1::-1])
        assert psnr(picture.image, expected) > 25


def test_places_are_limited_counted_and_given_back(server: Running) -> None:
    refused = server.registry.streams["main"].counters.thin_refused
    with viewing(server) as one, viewing(server) as two, viewing(server) as three, viewing(server) as packets:
        for plain in (one, two):
            ThinViewer(plain.connection).hello()
        text = generate_latest(collector_registry(server.registry)).decode()
        assert 'streamlod_thin_viewers{stream="main"} 2.0' in text
        with pytest.raises(ConnectionClosed) as closed:
            ThinViewer(three.connection).hello()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1013
        assert "2 viewers already" in closed.value.rcvd.reason
        packets.hello().until("caught_up")
    assert server.registry.streams["main"].counters.thin_refused == refused + 1
    limit = time.monotonic() + 60
    while server.registry.renderer.taken:
        assert time.monotonic() < limit
        time.sleep(0.01)
    with viewing(server) as plain:
        ThinViewer(plain.connection).hello()


def test_large_pictures_shrink_to_the_limit(server: Running, states: tuple[Path, list[Scene]]) -> None:
    camera = states[1][0].header.cameras[0].scaled(1600, 1200)
    with viewing(server) as plain:
        viewer = ThinViewer(plain.connection)
        viewer.hello()
        viewer.look(camera)
        height, width = viewer.picture().image.shape[:2]
    assert 150_000 < width * height <= 160_000
    assert width / height == pytest.approx(4 / 3, abs=0.01)


GOOD = {
    "type": "view", "width": 320, "height": 240, "rotation": np.eye(3).ravel().tolist(), "position": [0, 0, -3],
    "focal": [300, 300], "principal": [160, 120],
}  # fmt: skip


@pytest.mark.parametrize(
    "change",
    [
        {"width": 0}, {"width": 10**9}, {"width": 320.0}, {"height": True}, {"rotation": [1] * 9}, {"rotation": [1, 0]},
        {"rotation": [-1, 0, 0, 0, 1, 0, 0, 0, 1]}, {"rotation": ["1"] * 9}, {"position": [1e300, 0, 0]},
        {"position": None}, {"focal": [0, 300]}, {"focal": [300, 1e5]}, {"principal": [1e7, 0]}, {"principal": [[], 0]},
        {"type": "pick", "id": 1, "origin": [0, 0, 0], "direction": [0, 0, 0]},
        {"type": "pick", "id": -1, "origin": [0, 0, 0], "direction": [0, 0, 1]},
        {"type": "pick", "id": 1, "origin": [0, 0], "direction": [0, 0, 1]}, {"type": "ack", "picture": "1"},
    ],
    ids=str,
)  # fmt: skip
def test_refuses_views_out_of_bounds(change: dict[str, Any]) -> None:
    assert isinstance(parse_control(json.dumps(GOOD)), ViewMessage)
    with pytest.raises(SessionError) as refused:
        parse_control(json.dumps({**GOOD, **change}))
    assert refused.value.close_code == 4400


def test_pictures_are_asked_for_with_a_boolean() -> None:
    assert parse_hello('{"type":"hello","versions":[1],"pictures":true}').pictures
    with pytest.raises(SessionError):
        parse_hello('{"type":"hello","versions":[1],"pictures":{"width":1e9}}')


def test_a_server_that_draws_for_nobody_says_so(states: tuple[Path, list[Scene]]) -> None:
    with running(Settings(limits=Limits(thin_viewers=0)), StreamSpec(play=states[0])) as server:
        with viewing(server) as plain, pytest.raises(ConnectionClosed) as closed:
            ThinViewer(plain.connection).hello()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 4403


def test_who_shows_nothing_loses_the_place(states: tuple[Path, list[Scene]]) -> None:
    """Pings keep the connection, but a picture that is never acknowledged ends it."""
    limits = Limits(stuck_seconds=0.4, thin_viewers=1)
    with running(Settings(limits=limits), StreamSpec(play=states[0], loop=False)) as server:
        server.wait(lambda stream: stream["state"] == "ended")
        with viewing(server) as plain:
            viewer = ThinViewer(plain.connection)
            viewer.hello()
            viewer.look(states[1][0].header.cameras[0])
            with pytest.raises(ConnectionClosed) as closed:
                deque(plain.connection, maxlen=0)  # pictures that nobody acknowledges
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1013
        assert "no picture was acknowledged" in closed.value.rcvd.reason
        assert server.registry.renderer.taken == 0
        assert server.registry.streams["main"].counters.stuck == 1


def test_pace_follows_the_viewer() -> None:
    """Slow deliveries make pictures coarser, quick ones finer; a view at rest gets the finest where that is quick."""
    grades = GradeControl()
    for _ in range(4):
        grades.delivered(grades.moving, 1.0)
    assert grades.moving == len(GRADES) - 1
    for _ in range(60):
        grades.delivered(grades.moving, 0.01)
    assert grades.moving == 0
    grades.delivered(0, 0.3)
    assert (grades.moving, grades.resting(1)) == (1, 0)


@pytest.mark.parametrize("finest_seconds", [0.2, 4.0])
def test_one_slow_picture_does_not_keep_a_view_coarse(finest_seconds: float) -> None:
    """At rest the grade gets finer picture by picture until the finest, whatever one picture made expect."""
    grades, shown = GradeControl(), len(GRADES) - 1
    grades.delivered(shown, 0.5)  # by which the finest would take 27 s
    drawn = []
    while (index := grades.resting(shown)) != shown:
        shown = index
        drawn.append(shown)
        grades.delivered(shown, finest_seconds * GRADES[shown].scale ** 2)
    assert drawn[-1] == 0
    assert drawn[0] > 0, "one step first: the finest was expected to take long"


def test_a_view_that_would_cost_too_much_is_drawn_coarser(states: tuple[Path, list[Scene]]) -> None:
    scene = states[1][0]
    camera = scene.header.cameras[0].scaled(2048, 1536)
    count = 20_000  # each covers the whole picture: 20,000 x 6,144 tiles
    rng = np.random.default_rng(1)
    cloud = GaussianCloud(
        means=np.float32(camera.centre + 3 * camera.world_to_camera[2, :3]) + np.zeros((count, 3), np.float32),
        quaternions=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        scales=np.full((count, 3), 50, np.float32),
        opacities=np.full(count, 0.5, np.float32),
        colours=rng.random((count, 3), np.float32),
    )
    assert draw(cloud, camera, scene).shape == (1536, 2048, 3)


def test_fitted_sizes() -> None:
    camera = make_scene(60).header.cameras[0]  # 320 x 240
    assert (fitted(camera, 1, 10**6).width, fitted(camera, 0.5, 10**6).height) == (320, 120)
    assert (fitted(camera, 1, 4096).width, fitted(camera, 0.01, 10**6).width) == (73, 16)
