"""Capture nodes: what they find to film, and how they send it to a real server."""

from __future__ import annotations

import asyncio
import json
import logging
import ssl
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from starlette.websockets import WebSocket
from websockets.sync.server import ServerConnection, serve
from websockets.typing import Subprotocol

from streamlod.core.errors import InputError, SessionError
from streamlod.server.ingest.cameras.address import Address, webcam_options
from streamlod.server.ingest.push import node
from streamlod.server.ingest.push.capture import CaptureCamera
from streamlod.server.ingest.push.message import PUSH_SUBPROTOCOL, Codec, PushMessage, parse_push
from streamlod.server.ingest.push.node import Pushed, push
from streamlod.server.ingest.push.router import AnyIntake
from streamlod.server.ingest.push.sources import find_cameras
from tests.server.ingest.push.serving import serving_push
from tests.server.ingest.rig import FPS, burnt, number_of, write_clip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A video of a second, and three pictures."""
    write_clip(tmp_path / "cam0.ts", 1)
    (tmp_path / "cam1").mkdir()
    for number in range(3):
        cv2.imwrite(str(tmp_path / "cam1" / f"{number:03d}.png"), burnt(number))
    (tmp_path / "notes.txt").write_text("")
    return tmp_path


def test_finds_cameras_in_folders_and_by_name(folder: Path) -> None:
    found = find_cameras([str(folder), "door=v4l2:///dev/video0"], 25, (640, 480))
    assert [camera.name for camera in found] == ["cam0", "cam1", "door"]
    assert found[1].source == folder / "cam1"
    assert isinstance(found[2].source, Address)
    assert (found[2].source.format, found[2].fps, found[2].size) == ("v4l2", 25, (640, 480))
    assert webcam_options(25, (640, 480)) == {"framerate": "25", "video_size": "640x480"}
    named = find_cameras([f"a={folder / 'cam1'}", f"b={folder / 'cam0.ts'}"], 30)
    assert [camera.name for camera in named] == ["a", "b"]


@pytest.mark.parametrize(
    ("argument", "fault"),
    [
        ("nothing", "is not a folder"),
        ("a=nothing.mp4", "does not exist"),
        ("a=push:", "let the server read it"),
        ("a=rtsp+listen://0.0.0.0:5/x", "let the server read it"),
        ("a=gopher://x", "scheme"),
        ("{}/empty", "holds no video"),
        ("a={}/empty", "holds no JPEG"),
    ],
)
def test_refuses_what_cannot_be_filmed(folder: Path, argument: str, fault: str) -> None:
    (folder / "empty").mkdir()
    with pytest.raises(InputError, match=fault):
        find_cameras([argument.format(folder)], 30)
    with pytest.raises(InputError, match="twice"):
        find_cameras([str(folder), f"cam0={folder / 'cam0.ts'}"], 30)
    with pytest.raises(InputError, match="size: is asked of webcams, of which there is none"):
        find_cameras([str(folder)], 30, (640, 480))


def test_pictures_come_at_their_pace_with_their_times(folder: Path) -> None:
    video, pictures = find_cameras([str(folder)], FPS, repeats=True)
    start = time.time_ns()
    taken = [next(stream) for stream in [pictures.pictures(start)] for _ in range(5)]
    assert [round((one.capture_ns - start) * FPS / 1e9) for one in taken] == [0, 1, 2, FPS, FPS + 1]  # with the video
    assert time.time_ns() >= taken[-1].capture_ns
    assert [one.codec for one in taken] == [Codec.PNG] * 5
    files = [(folder / "cam1" / f"{number:03d}.png").read_bytes() for number in range(3)]
    assert [one.body for one in taken] == [files[number % 3] for number in range(5)]
    filmed = list(CaptureCamera("cam0", video.source, FPS).pictures(time.time_ns() - 10**10))
    assert len(filmed) == FPS
    assert [round((one.capture_ns - filmed[0].capture_ns) * FPS / 1e9) for one in filmed] == list(range(FPS))
    decoded = [cv2.imdecode(np.frombuffer(one.body, np.uint8), cv2.IMREAD_COLOR) for one in filmed]
    assert [number_of(np.asarray(image, np.uint8)) for image in decoded] == list(range(FPS))


def test_an_address_that_is_none_is_refused_before_any_camera_is_opened() -> None:
    cameras = find_cameras(["a=v4l2:///dev/video99"], 30)
    with pytest.raises(InputError, match="is no address"):
        push("ws://127.0.0.1:99999/v1/streams/main/ingest", cameras)


def test_a_webcam_that_is_not_there_is_named() -> None:
    (camera,) = find_cameras(["a=v4l2:///dev/video99"], 30)
    with pytest.raises(InputError, match="/dev/video99"):
        next(camera.pictures(0))


class Server:
    """The push route with intakes that keep what they take; behaves as told."""

    def __init__(self) -> None:
        self.taken: list[PushMessage] = []
        self.refusal: SessionError | None = None
        self.breaks_after = self.delay = 0.0
        self.connections = 0

    async def open(self, _: WebSocket, __: str) -> AnyIntake:
        self.connections += 1
        await asyncio.sleep(0)
        if self.refusal is not None:
            raise self.refusal
        return self

    def accept(self, message: PushMessage) -> None:
        if message.camera == "odd":
            raise InputError("camera odd", "is not one of the rig's that are pushed")
        if self.breaks_after and len(self.taken) == self.breaks_after:
            self.breaks_after = 0
            raise SessionError(1013, "the stream takes no pictures at present; try again later")
        time.sleep(self.delay)
        self.taken.append(message)

    def close(self) -> None:
        pass


@pytest.fixture
def served() -> Iterator[tuple[Server, str]]:
    server = Server()
    with serving_push(server.open) as port:
        yield server, f"ws://127.0.0.1:{port}/v1/streams/main/ingest"


def test_every_picture_is_sent_and_acknowledged(
    folder: Path, served: tuple[Server, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node, "_MAX_UNACKNOWLEDGED", 1000)  # none is dropped, however slow this machine is
    server, url = served
    cameras = find_cameras([str(folder), f"odd={folder / 'cam1'}"], FPS)
    assert push(url, cameras) == {"cam0": Pushed(FPS), "cam1": Pushed(3), "odd": Pushed(0, 3)}
    for name, count in (("cam0", FPS), ("cam1", 3)):
        messages = [message for message in server.taken if message.camera == name]
        assert [message.sequence for message in messages] == list(range(count))
    firsts = [next(m.capture_ns for m in server.taken if m.camera == name) for name in ("cam0", "cam1")]
    assert firsts[0] == firsts[1]  # all cameras of a node start together


def test_a_slow_server_gets_newer_pictures_and_drops_are_counted(folder: Path, served: tuple[Server, str]) -> None:
    server, url = served
    server.delay = 0.1
    (pushed,) = push(url, find_cameras([f"cam0={folder / 'cam0.ts'}"], FPS)).values()
    assert pushed.dropped >= FPS / 3
    assert pushed.acknowledged + pushed.dropped == FPS
    assert len(server.taken) == pushed.acknowledged


@pytest.mark.long
def test_a_broken_connection_is_made_anew(
    tmp_path: Path, served: tuple[Server, str], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The film is much longer than it takes to come back."""
    caplog.set_level(logging.INFO, logger=node.__name__)
    monkeypatch.setattr(node, "_MAX_UNACKNOWLEDGED", 1000)  # pictures are dropped while there is no connection only
    write_clip(tmp_path / "cam0.ts", 3)
    server, url = served
    server.breaks_after = 5
    (pushed,) = push(url, find_cameras([f"cam0={tmp_path / 'cam0.ts'}"], FPS)).values()
    assert server.connections == 2
    assert server.taken[-1].sequence == 3 * FPS - 1
    assert pushed.dropped >= 5
    assert pushed.acknowledged + pushed.dropped == 3 * FPS
    told = [record.getMessage() for record in caplog.records if record.name == node.__name__]
    assert [text.endswith("trying again") for text in told] == [True, False]
    assert told[1] == "camera cam0: connected"


def test_a_server_that_falls_silent_is_left_and_what_it_did_not_take_is_counted(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node, "_ANSWER_SECONDS", 0.2)
    left = threading.Event()

    def listen(connection: ServerConnection) -> None:
        for _ in connection:
            pass
        left.set()

    with serve(listen, "127.0.0.1", 0, subprotocols=[Subprotocol(PUSH_SUBPROTOCOL)]) as silent:
        threading.Thread(target=silent.serve_forever, daemon=True).start()
        url = f"ws://127.0.0.1:{silent.socket.getsockname()[1]}/v1/streams/main/ingest"
        (pushed,) = push(url, find_cameras([f"cam0={folder / 'cam0.ts'}"], FPS)).values()
        assert left.wait(5)
        silent.shutdown()
    assert (pushed.acknowledged, pushed.dropped) == (0, FPS)


def test_a_refusal_for_good_ends_it_with_the_reason(folder: Path, served: tuple[Server, str]) -> None:
    server, url = served
    server.refusal = SessionError(4403, "the token does not give the right to publish here")
    with pytest.raises(InputError, match="does not give the right to publish"):
        push(url, find_cameras([f"cam0={folder / 'cam0.ts'}"], FPS))


def test_a_certificate_of_ones_own_making_is_trusted_when_it_is_named(tmp_path: Path, folder: Path) -> None:
    certificate, key = tmp_path / "own.pem", tmp_path / "own.key"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "1",
         "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-keyout", key, "-out", certificate],
        check=True, capture_output=True,
    )  # fmt: skip
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)

    def acknowledge(connection: ServerConnection) -> None:
        for data in connection:
            message = parse_push(bytes(data))  # type: ignore[arg-type]
            connection.send(json.dumps({"type": "ack", "camera": message.camera, "sequence": message.sequence}))

    protocols = [Subprotocol(PUSH_SUBPROTOCOL)]
    with serve(acknowledge, "127.0.0.1", 0, ssl=context, subprotocols=protocols) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"wss://localhost:{server.socket.getsockname()[1]}/v1/streams/main/ingest"
        cameras = find_cameras([f"cam1={folder / 'cam1'}"], FPS)
        assert push(url, cameras, ca=certificate)["cam1"].acknowledged == 3
        assert push(url, cameras)["cam1"] == Pushed(0, 0, 3)  # not trusted
        server.shutdown()
    for wrong in (key, tmp_path / "none.pem"):
        with pytest.raises(InputError, match="holds no certificates"):
            push(url, cameras, ca=wrong)
