"""What a live stream does: its worker fed by pushed pictures, its state, its metrics, and who may push."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import multiprocessing
import threading
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import pytest
from prometheus_client import generate_latest
from prometheus_client.core import CollectorRegistry
from prometheus_client.registry import Collector
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.packet.info import peek
from streamlod.core.errors import InputError, ModelError, SessionError
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.keyframe import as_keyframe
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.server.ingest.push.message import PUSH_SUBPROTOCOL, Codec, PushMessage, pack_push
from streamlod.server.ingest.sync.camera_track import CameraState
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.pipeline.stages.opened import open_job
from streamlod.server.pipeline.stages.stream import train_stream
from streamlod.server.service.ingest_metrics import ingest_families
from streamlod.server.settings import Settings, load_settings
from streamlod.server.worker.camera_pictures import unpack_pictures
from streamlod.server.worker.messages import Sender, Tag
from streamlod.server.worker.training import train
from tests.server.brief import brief_training
from tests.server.conftest import Clip, running
from tests.server.figures import figures
from tests.server.ingest.push.serving import relayed

SPEC = SyntheticSpec(cameras=4, frames=6, width=96, height=54, seed=2)
FPS = 30
PAGE = (Path(__file__).parents[2] / "docs" / "operations.md").read_text()


def definition() -> dict[str, Any]:
    """The synthetic rig as one of capture nodes."""
    cameras = [
        {
            "name": camera.name,
            "source": "push:",
            "width": camera.width,
            "height": camera.height,
            "intrinsics": camera.intrinsics.tolist(),
            "world_to_camera": camera.world_to_camera.tolist(),
        }
        for camera in open_synthetic(SPEC).cameras
    ]
    return {"fps": FPS, "policy": {"quorum": 2}, "depth_bounds": [0.5, 12], "cameras": cameras}


class Node:
    """A capture node in a thread: films the synthetic room at thirty instants a second until told to stop.

    Args:
        instants: it films so many and stays connected; all by default.
    """

    def __init__(self, socket: Path, instants: float = math.inf) -> None:
        self._socket, self._instants, self._stopping = socket, instants, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        pictures = [
            [bytes(cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1]) for image in frame.images]
            for frame in open_synthetic(SPEC).frames()
        ]
        names = [camera.name for camera in open_synthetic(SPEC).cameras]
        while not self._socket.exists() and not self._stopping.wait(0.02):
            pass
        intake, begin = relayed(self._socket), time.time_ns()
        number = 0
        with contextlib.suppress(SessionError):  # training that has all its frames takes no more
            while not self._stopping.wait(max(0.0, (begin + number * 1e9 / FPS - time.time_ns()) / 1e9)):
                capture = begin + number * 1_000_000_000 // FPS
                for name, picture in zip(names, pictures[number % len(pictures)], strict=True):
                    intake.accept(PushMessage(name, number, capture, Codec.PNG, picture))
                number += 1
            if number >= self._instants:
                self._stopping.wait()
        intake.close()

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join(60)


def _trained(job: TrainJob, scene: Scene | None, start: int, socket: Path) -> list[tuple[Tag, bytes, int]]:
    """What a worker sends that trains what a node films, and when it came."""
    ours, theirs = multiprocessing.Pipe(duplex=False)
    messages: list[tuple[Tag, bytes, int]] = []

    def listen() -> None:
        while (data := ours.recv_bytes()) and data[0] != Tag.END:
            messages.append((Tag(data[0]), data[1:], time.time_ns()))

    listener = threading.Thread(target=listen)
    listener.start()
    node = Node(socket)
    with brief_training():
        sender = Sender(theirs)
        train(job, scene, start, sender, socket, camera_pictures=True)
        node.stop()
        sender.send(Tag.END)
    listener.join(60)
    return messages


@pytest.mark.long
def test_training_that_continues_a_scene_tells_of_its_cameras_too(tmp_path: Path) -> None:
    heard = definition()["cameras"][0]["name"]
    job = TrainJob(live=definition() | {"sound": heard}, preset="live", frames=2, points="random")
    decoder = SceneDecoder()
    for tag, body, _ in _trained(job, None, 0, tmp_path / "s"):
        if tag is Tag.PACKET:
            decoder.push(body)
    assert decoder.scene is not None
    scene = as_keyframe(decoder.scene, decoder.scene.version + 1)
    messages = _trained(replace(job, frames=4), scene, 2, tmp_path / "t")
    told = [json.loads(body) for tag, body, _ in messages if tag is Tag.INGEST]
    sent = [peek(body).to_version for tag, body, _ in messages if tag is Tag.PACKET]
    assert sent == [scene.version + 1, scene.version + 2]
    assert [json.loads(body) for tag, body, _ in messages if tag is Tag.MICROPHONE] == [{"camera": heard}]
    assert told
    assert told[-1]["cameras"].keys() == {camera["name"] for camera in definition()["cameras"]}


@pytest.mark.long
def test_training_that_is_slower_than_filming_gets_the_newest_instant(tmp_path: Path) -> None:
    whole = definition() | {"policy": "require_all"}  # or the last camera may be late for every instant
    job = TrainJob(live=whole, preset="live", frames=4, points="random")
    messages = _trained(job, None, 0, tmp_path / "s")
    packets = [(peek(body), at) for tag, body, at in messages if tag is Tag.PACKET]
    told = [json.loads(body) for tag, body, _ in messages if tag is Tag.INGEST]
    seen = [unpack_pictures(body) for tag, body, _ in messages if tag is Tag.PICTURES]
    assert 1 <= len(seen) < len(told), "about one a second, figures come twice as often"
    assert all(picture[:2] == b"\xff\xd8" for pictures in seen for picture in pictures.values())
    assert all(pictures.keys() == {camera["name"] for camera in whole["cameras"]} for pictures in seen)
    reports = [json.loads(body) for tag, body, _ in messages if tag is Tag.REPORT]
    assert len(packets) == len(reports) == 4
    steps = [(b[0].time_ns - a[0].time_ns) * FPS / 1e9 for a, b in pairwise(packets)]
    assert all(step > 0.9 and abs(step - round(step)) < 1e-3 for step in steps)
    assert steps[0] > 2  # the first frame took longer than many instants
    last = told[-1]
    assert last["dropped_stale"] > 0
    assert {camera["clock_source"] for camera in last["cameras"].values()} == {"stated"}
    for report, (packet, at) in zip(reports, packets, strict=True):
        assert report["latency_seconds"] * 1e9 <= at - packet.time_ns
        names, begins, ends = zip(*report["stages"], strict=True)
        assert (names[0], names[-1], "read" in names) == ("ingest", "encode", False)
        assert abs(begins[0] - packet.time_ns) < 1e8  # it was filmed then
        assert begins[0] <= min(begins[1:]) <= max(ends) == ends[-1] <= at
    waited = reports[-1]["latency_seconds"] - reports[-1]["total_seconds"]  # before training
    assert waited < reports[0]["total_seconds"] / 2  # a queue would hold what came while the first frame trained


@pytest.mark.long
def test_a_failing_encoder_ends_training_that_waits_for_cameras(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node, opened = (
        Node(tmp_path / "s"),
        open_job(TrainJob(live=definition(), preset="live", points="random"), tmp_path / "s"),
    )

    def broken(*_: object, **__: object) -> bytes:
        node.stop()  # no further picture will come
        deadline = time.monotonic() + 20  # or it waits for room: it may have trained some more by now
        while (not (told := opened.statistics()) or not told.waiting) and time.monotonic() < deadline:
            time.sleep(0.05)
        raise ModelError("the encoder broke")

    monkeypatch.setattr("streamlod.server.pipeline.stages.encoding.encode_keyframe", broken)
    with brief_training(), pytest.raises(ModelError, match="the encoder broke"):
        next(train_stream(opened))
    assert "training" not in {thread.name for thread in threading.enumerate()}


def test_metrics_of_cameras_are_what_the_worker_told_and_documented() -> None:
    class Ingest(Collector):
        def collect(self) -> Any:
            return ingest_families({"main": figures(CameraState.LOST, knocked=True), "file": None})

    registry = CollectorRegistry()
    registry.register(Ingest())
    lines = [line for line in generate_latest(registry).decode().splitlines() if not line.startswith("#")]
    values = dict(line.rsplit(" ", 1) for line in lines)
    assert float(values['streamlod_ingest_dropped_stale_total{stream="main"}']) == 6
    assert float(values['streamlod_ingest_latency_seconds{stream="main"}']) == 0.008
    assert float(values['streamlod_camera_lost{camera="cam1",stream="main"}']) == 1
    assert float(values['streamlod_camera_knocked{camera="cam0",stream="main"}']) == 1
    assert float(values['streamlod_camera_skew_seconds{camera="cam0",stream="main"}']) == -0.002
    assert float(values['streamlod_camera_missing_total{camera="cam0",stream="main"}']) == 4
    assert float(values['streamlod_camera_drift_ppm{camera="cam0",stream="main"}']) == -3.5
    assert not [name for name in values if "file" in name]
    for name in {key.split("{")[0] for key in values}:
        assert f"`{name}`" in PAGE, name


def test_live_streams_by_rest_and_who_may_push(clip: Clip, tmp_path: Path) -> None:
    tokens = [
        {"name": name, "sha256": hashlib.sha256(name.encode()).hexdigest(), "rights": rights}
        for name, rights in (("node", ["publish"]), ("page", ["read"]), ("boss", ["control", "read"]))
    ]
    (tmp_path / "tokens.json").write_text(json.dumps(tokens))
    picture = pack_push(PushMessage("cam00", 0, None, Codec.PNG, bytes(100_000)))

    def refusal(stream: str, token: str, **options: Any) -> tuple[int, str]:
        url = f"ws://127.0.0.1:{server.port}/v1/streams/{stream}/ingest"
        headers = {"Authorization": f"Bearer {token}"}
        with connect(url, subprotocols=[PUSH_SUBPROTOCOL], additional_headers=headers, proxy=None, **options) as node:  # type: ignore[list-item]
            with contextlib.suppress(ConnectionClosed):
                node.send(picture)
            with pytest.raises(ConnectionClosed) as closed:
                node.recv(60)
            assert closed.value.rcvd is not None
            return closed.value.rcvd.code, closed.value.rcvd.reason

    with running(Settings(tokens=tmp_path / "tokens.json"), StreamSpec(play=clip.path)) as server:
        headers = {"Authorization": "Bearer boss"}
        with server.client(headers=headers) as client:
            created = client.post("/v1/streams", json={"id": "cams", "live": definition()})
            assert created.status_code == 201, created.text
            assert (created.json()["state"], created.json()["ingest"]) == ("idle", None)
            missing = client.post("/v1/streams", json={"id": "other", "live": str(tmp_path / "none.json")})
            assert missing.status_code == 422
            both = client.post("/v1/streams", json={"id": "other", "live": {}, "data": "."})
            assert both.status_code == 422
        assert refusal("cams", "node")[0] == 1013  # it has not been started
        assert refusal("cams", "page")[0] == 4403
        assert refusal("cams", "nobody")[0] == 4401
        assert refusal("none", "node")[0] == 4404
        assert refusal("main", "node") == (4403, "this stream takes no pictures: it is not made from live cameras")
        assert refusal("cams", "node", origin="http://elsewhere.example")[0] == 4403


def test_streams_of_the_configuration_file(tmp_path: Path) -> None:
    file = tmp_path / "server.toml"
    file.write_text(
        '[[streams]]\nid = "stage"\nlive = "rig.json"\nviews = 4\n[[streams]]\nid = "old"\nplay = "a.slod"\n'
    )
    stage, old = (stream.spec for stream in load_settings(file).streams)
    assert stage == StreamSpec("stage", TrainJob(live=Path("rig.json"), views=4, preset="live"))
    assert old == StreamSpec("old", play=Path("a.slod"))
    file.write_text('[[streams]]\nid = "Stage"\nlive = "rig.json"\n')
    with pytest.raises(InputError, match=r"streams\.0\.id"):
        load_settings(file)
