"""Capture nodes: the message format and its limits, pictures through a real websocket and the worker's socket."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import msgpack
import numpy as np
import pytest
import websockets.sync.client as websocket_client
from hypothesis import given, settings
from hypothesis import strategies as st
from starlette.websockets import WebSocket
from websockets.exceptions import ConnectionClosed

from streamlod.core.errors import InputError, SessionError
from streamlod.core.frames import FrameSet
from streamlod.server.ingest.cameras.definition import read_definition
from streamlod.server.ingest.live import LiveDataset, open_live
from streamlod.server.ingest.push.intake import Intake
from streamlod.server.ingest.push.message import (
    MAX_MESSAGE_BYTES,
    PUSH_SUBPROTOCOL,
    Codec,
    PushMessage,
    pack_push,
    parse_push,
)
from streamlod.server.ingest.push.relay import RelayedIntake, listening
from streamlod.server.ingest.rig import Rig
from streamlod.server.ingest.sync.camera_track import CameraState
from streamlod.server.ingest.sync.clock import ClockSource
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.worker.ingest_report import complaint
from tests.server.ingest.push.serving import relayed, serving_push
from tests.server.ingest.rig import FPS, HEIGHT, WIDTH, burnt, number_of, write_definition
from tests.server.ingest.together import load_together

SECOND = 1_000_000_000


def encoded(number: int, suffix: str = ".png") -> bytes:
    ok, data = cv2.imencode(suffix, burnt(number))
    assert ok
    return bytes(data)


def message(number: int, camera: str = "cam0", capture_ns: int | None = None) -> PushMessage:
    return PushMessage(camera, number, capture_ns, Codec.PNG, encoded(number))


def test_a_message_there_and_back() -> None:
    sent = PushMessage("cam0", 2**40, 1_790_000_000_000_000_000, Codec.H264, b"\0\0\0\1x")
    assert parse_push(pack_push(sent)) == sent
    golden = bytes.fromhex(
        "002b 84 a663616d657261 a163 a873657175656e6365 07 aa636170747572655f6e73 c0 a5636f646563 a46a706567 ff"
    )
    assert parse_push(golden) == PushMessage("c", 7, None, Codec.JPEG, b"\xff")
    assert pack_push(PushMessage("c", 7, None, Codec.JPEG, b"\xff")) == golden
    assert pack_push(parse_push(golden)) is golden  # passed on as it came
    of_a_page = bytes.fromhex(  # the same as in modules.test.mjs
        "0041 84 d90663616d657261 d90163 d90873657175656e6365 cf0000000000000007"
        "d90a636170747572655f6e73 cf18d75b8423f6d090 d905636f646563 d9046a706567 ff"
    )
    assert parse_push(of_a_page) == PushMessage("c", 7, 1_790_000_000_000_250_000, Codec.JPEG, b"\xff")


GOOD: dict[str, Any] = {"camera": "c", "sequence": 1, "capture_ns": 5, "codec": "png"}


@pytest.mark.parametrize(
    "fields",
    [
        GOOD | {"camera": 3},
        GOOD | {"camera": "c" * 200},
        GOOD | {"sequence": -1},
        GOOD | {"sequence": True},
        GOOD | {"sequence": 2**60},
        GOOD | {"capture_ns": 1.5},
        GOOD | {"codec": "gif"},
        GOOD | {"codec": ["png"]},
        GOOD | {"more": 1},
        {"camera": "c"},
        [1, 2],
        7,
    ],
)
def test_refuses_headers_that_break_the_rules(fields: object) -> None:
    header = msgpack.packb(fields)
    with pytest.raises(SessionError) as refusal:
        parse_push(len(header).to_bytes(2, "big") + header + b"body")
    assert refusal.value.close_code == 4400


def test_refuses_what_is_too_big_or_cut() -> None:
    with pytest.raises(SessionError) as refusal:
        parse_push(bytes(MAX_MESSAGE_BYTES + 1))
    assert refusal.value.close_code == 1009
    whole = pack_push(message(1))
    length = int.from_bytes(whole[:2], "big")
    for cut in range(2 + length + 1):
        with pytest.raises(SessionError):
            parse_push(whole[:cut])


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=80))
def test_any_bytes_are_a_message_or_refused(data: bytes) -> None:
    for candidate in (data, len(data).to_bytes(2, "big") + data + b"x"):
        with contextlib.suppress(SessionError):
            assert parse_push(candidate).body


class Frames:
    """Reads a live data set on a thread."""

    def __init__(self, dataset: LiveDataset) -> None:
        self.dataset, self.got = dataset, list[FrameSet]()
        self._thread = threading.Thread(target=lambda: self.got.extend(dataset.frames(0, 30)), daemon=True)
        self._thread.start()
        while dataset.rig is None:
            time.sleep(0.005)

    def wait(self, condition: Any) -> None:
        end = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < end
            time.sleep(0.01)

    def close(self) -> None:
        self.dataset.close()
        self._thread.join(60)
        assert not self._thread.is_alive()


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Frames]:
    frames = Frames(open_live(write_definition(tmp_path, ["push:", "push:"]), push_socket=tmp_path / "s"))
    yield frames
    frames.close()


def test_pictures_of_two_nodes_are_paired_by_the_time_they_state(live: Frames) -> None:
    rig = live.dataset.rig
    assert rig is not None
    nodes, begin = [Intake(rig), Intake(rig)], rig.now_ns
    for k in range(12):
        for row, node in enumerate(nodes):
            node.accept(message(k, f"cam{row}", begin + k * 1_000_000_000 // FPS))
    live.wait(lambda: len(live.got) >= 1)
    statistics = live.dataset.statistics()
    assert statistics is not None
    assert {camera.clock_source for camera in statistics.cameras.values()} == {ClockSource.STATED}
    for node in nodes:
        node.accept(message(11, "cam0", begin))  # a repeat for the first node, unheard of for the second
        node.close()
    for frame in live.got:
        assert frame.present.all()
        assert len({number_of(image) for image in frame.images}) == 1
    statistics = live.dataset.statistics()
    assert statistics is not None
    assert statistics.degraded
    assert statistics.cameras["cam0"].counts.received in (12, 13)


def test_a_clock_that_jumps_an_hour_back_is_told_once(live: Frames, caplog: pytest.LogCaptureFixture) -> None:
    """As at the end of summer time, where a camera is set to local time."""
    rig = live.dataset.rig
    assert rig is not None
    node, hour, numbers = Intake(rig), 3600 * 10**9, itertools.count(1)
    node.accept(message(0, "cam0", rig.now_ns))

    def is_timed_by_arrival() -> bool:
        number = next(numbers)
        node.accept(message(number, "cam0", rig.now_ns - hour))
        return rig.statistics().cameras["cam0"].clock_source is ClockSource.ARRIVAL

    live.wait(is_timed_by_arrival)  # a second later, as its delay must be known
    assert is_timed_by_arrival()
    (told,) = (record.getMessage() for record in caplog.records if "clock" in record.getMessage())
    assert told == "camera cam0: its clock is 5 s off or more, or silent; its pictures are timed by their arrival"


def test_the_later_of_two_nodes_with_one_camera_counts(live: Frames) -> None:
    rig = live.dataset.rig
    assert rig is not None
    rig._synchroniser._lost_ns = 60_000_000_000  # a second of silence shall not count
    early, late, now = Intake(rig), Intake(rig), rig.now_ns
    early.accept(message(0, "cam0", now))
    early.accept(message(0, "cam1", now))
    late.accept(message(1, "cam0", now + 30_000_000))
    with pytest.raises(InputError, match="another phone or capture node"):
        early.accept(message(1, "cam0", now + 30_000_000))
    early.accept(message(1, "cam1", now + 30_000_000))
    early.close()
    states = {name: camera.state for name, camera in rig.statistics().cameras.items()}
    assert states == {"cam0": CameraState.OK, "cam1": CameraState.LOST}


def test_a_rig_is_in_operation_once_it_takes_what_is_pushed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that who waits for it may push at once."""
    live = open_live(write_definition(tmp_path, ["push:", "push:"]), push_socket=tmp_path / "s")
    before: list[object] = []

    def listening_later(*arguments: Any) -> Any:
        before.append(live.rig)
        return listening(*arguments)

    monkeypatch.setattr("streamlod.server.ingest.live.listening", listening_later)
    frames = Frames(live)
    RelayedIntake(tmp_path / "s").close()
    frames.close()
    assert before == [None]


def test_refuses_pictures_that_do_not_fit(live: Frames) -> None:
    rig = live.dataset.rig
    assert rig is not None
    intake = Intake(rig)
    small = bytes(cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1])
    bomb = bytearray(encoded(1))
    bomb[16:24] = (60000).to_bytes(4, "big") * 2
    for camera, codec, body, reason in [
        ("cam9", Codec.PNG, encoded(1), "not one of"),
        ("cam0", Codec.JPEG, small, "8x8"),
        ("cam0", Codec.PNG, bytes(bomb), "60000x60000"),
        ("cam0", Codec.JPEG, b"GIF89a", "no JPEG picture"),
        ("cam0", Codec.H264, b"\0\0\1\x65" + bytes(range(200)), "does not decode"),
    ]:
        with pytest.raises(InputError, match=reason):
            intake.accept(PushMessage(camera, 5, rig.now_ns, codec, body))


def test_what_a_node_was_refused_goes_with_it(tmp_path: Path) -> None:
    """A phone that films as another camera, or not at all, leaves no complaint of a picture's size or damage behind."""
    live = Frames(open_live(write_definition(tmp_path, ["push:", "push:"], {"quorum": 1})))
    rig = live.dataset.rig
    assert rig is not None
    first, other = Intake(rig), Intake(rig)
    small = bytes(cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1])
    with pytest.raises(InputError, match="8x8"):
        first.accept(PushMessage("cam0", 1, rig.now_ns, Codec.JPEG, small))
    first.accept(PushMessage("cam1", 1, rig.now_ns, Codec.PNG, encoded(3)))
    rig.findings.note_decoded("cam1", "sent a picture that does not decode")  # as training finds out
    assert "8x8" in rig.statistics().cameras["cam0"].refused
    with pytest.raises(InputError, match="8x8"):
        other.accept(PushMessage("cam1", 1, rig.now_ns, Codec.JPEG, small))
    other.close()  # it never held cam1, which first still sends
    assert rig.statistics().cameras["cam1"].refused
    first.close()
    cameras = rig.statistics().cameras
    live.close()
    assert {name: (camera.refused, camera.fault) for name, camera in cameras.items()} == {
        "cam0": ("", ""),
        "cam1": ("", "its phone or capture node has disconnected"),
    }


@pytest.mark.parametrize(
    ("clock", "words"),
    [
        (lambda ns, begin_ns: begin_ns, "camera cam1's times stand still: restart it"),
        (lambda ns, begin_ns: 2 * begin_ns - ns, "camera cam1's times run backwards: restart it"),
        (lambda ns, begin_ns: ns + 3 * SECOND, "camera cam1's times are far from those of the other cameras: set its"),
    ],
)
def test_a_node_whose_clock_is_wrong_is_named_until_it_is_well_again(
    tmp_path: Path, clock: Callable[[int, int], int], words: str
) -> None:
    names = ("cam0", "cam1", "cam2")
    rig = Rig(read_definition(write_definition(tmp_path, ["push:"] * 3, {"quorum": 2})), names)
    node, begin_ns, numbers = Intake(rig), rig.now_ns, itertools.count()

    def said(is_wrong: bool) -> str:
        """What is said after another picture of each camera."""
        number, now_ns = next(numbers), rig.now_ns
        for camera in names:
            told_ns = clock(now_ns, begin_ns) if is_wrong and camera == "cam1" else now_ns
            node.accept(message(number, camera, told_ns))
        return complaint(json.loads(json.dumps(asdict(rig.statistics()))))

    for is_wrong, beginning in ((False, ""), (True, words), (False, "")):
        end_ns = rig.now_ns + 30 * SECOND
        while not (sentence := said(is_wrong)).startswith(beginning) or (sentence and not beginning):
            assert rig.now_ns < end_ns, sentence
            time.sleep(0.02)


def test_a_damaged_picture_counts_as_missing(tmp_path: Path) -> None:
    path = write_definition(tmp_path, ["push:", "push:"], {"quorum": 1})
    live = Frames(open_live(path))
    rig = live.dataset.rig
    assert rig is not None
    intake, now = Intake(rig), rig.now_ns
    whole = encoded(3)
    intake.accept(PushMessage("cam0", 3, now, Codec.PNG, whole[:60] + bytes(20) + whole[80:]))
    intake.accept(PushMessage("cam1", 3, now, Codec.PNG, whole))
    live.wait(lambda: rig.statistics().delivered >= 1)
    live.wait(lambda: "decode" in rig.statistics().cameras["cam0"].refused)
    live.close()
    assert [list(frame.present) for frame in live.got] == [[False, True]]


def h264_encoder() -> av.VideoCodecContext:
    encoder = av.CodecContext.create("libx264", "w")
    assert isinstance(encoder, av.VideoCodecContext)
    encoder.width, encoder.height, encoder.pix_fmt, encoder.framerate = WIDTH, HEIGHT, "yuv420p", Fraction(FPS)
    encoder.options = {"tune": "zerolatency", "preset": "ultrafast"}
    return encoder


class Keeping:
    """A rig that keeps the pictures that it is given."""

    def __init__(self, rig: Any) -> None:
        self._rig, self.pictures = rig, list[Picture]()

    def put(self, picture: Picture) -> None:
        self.pictures.append(picture)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._rig, name)


def test_several_threads_may_load_one_picture_of_a_phone(live: Frames) -> None:
    """A walk is recorded and watched at once; FFmpeg's conversion of one frame by two threads hangs or crashes."""
    encoder, keeping = h264_encoder(), Keeping(live.dataset.rig)
    rig: Any = keeping
    intake = Intake(rig)
    for k in range(4):
        (packet,) = encoder.encode(av.VideoFrame.from_ndarray(burnt(k), format="rgb24"))
        intake.accept(PushMessage("cam0", k, None, Codec.H264, bytes(packet)))
    assert len(keeping.pictures) == 4
    assert load_together(keeping.pictures, 200)


def test_a_genlocked_rig_counts_by_frame_number_and_h264_decodes(live: Frames) -> None:
    rig = live.dataset.rig
    assert rig is not None
    encoder = h264_encoder()
    intakes = [Intake(rig), Intake(rig)]
    for k in range(100, 110):
        (packet,) = encoder.encode(av.VideoFrame.from_ndarray(burnt(k), format="rgb24"))
        intakes[0].accept(PushMessage("cam0", k, None, Codec.H264, bytes(packet)))
        intakes[1].accept(PushMessage("cam1", k, None, Codec.PNG, encoded(k)))
        time.sleep(0.01)
    live.wait(lambda: len(rig.statistics().cameras) and rig.statistics().delivered >= 1)
    assert {c.clock_source for c in rig.statistics().cameras.values()} == {ClockSource.FRAME_NUMBER}
    live.close()
    assert live.got
    for frame in live.got:
        assert len({number_of(image) for image in frame.images}) == 1


@contextlib.contextmanager
def serving(socket_path: Path) -> Iterator[int]:
    """A real server with the push route, relaying to the worker's socket."""

    async def open_intake(_: WebSocket, stream_id: str) -> RelayedIntake:
        if stream_id != "main":
            raise SessionError(4404, "there is no such stream")
        return await asyncio.to_thread(relayed, socket_path)

    with serving_push(open_intake) as port:
        yield port


def test_a_capture_node_over_the_websocket_and_the_workers_socket(live: Frames, tmp_path: Path) -> None:
    with serving(tmp_path / "s") as port:
        url = f"ws://127.0.0.1:{port}/v1/streams/"
        with websocket_client.connect(url + "main/ingest", subprotocols=[PUSH_SUBPROTOCOL]) as node:  # type: ignore[list-item]
            begin = time.time_ns()
            for k in range(8):
                for camera in ("cam0", "cam1"):
                    node.send(pack_push(message(k, camera, begin + k * 1_000_000_000 // FPS)))
                    answer = json.loads(node.recv(60))
                    assert answer == {"type": "ack", "camera": camera, "sequence": k}
            node.send(pack_push(message(9, "cam7", begin)))
            refused = json.loads(node.recv(60))
            assert refused["type"] == "refused"
            assert "not one of" in refused["reason"]
            node.send(b"\0")
            with pytest.raises(ConnectionClosed):
                node.recv(60)
            assert node.close_code == 4400
        with (
            websocket_client.connect(url + "other/ingest", subprotocols=[PUSH_SUBPROTOCOL]) as node,  # type: ignore[list-item]
            pytest.raises(ConnectionClosed, match="no such stream"),
        ):
            node.recv(60)
    live.wait(lambda: live.dataset.statistics() is not None and live.dataset.statistics().delivered >= 1)  # type: ignore[union-attr]
    live.wait(lambda: live.dataset.statistics().degraded)  # type: ignore[union-attr]  # the node has gone


def test_a_worker_that_hangs_holds_up_its_own_capture_nodes_alone(tmp_path: Path) -> None:
    place = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as hung, serving(place) as port, contextlib.ExitStack() as stack:
        hung.bind(str(place))
        hung.listen(64)  # takes pictures and never answers
        url = f"ws://127.0.0.1:{port}/v1/streams/main/ingest"
        for _ in range((os.cpu_count() or 1) + 8):  # more than the shared pool has threads
            node = stack.enter_context(websocket_client.connect(url, subprotocols=[PUSH_SUBPROTOCOL]))  # type: ignore[list-item]
            node.send(pack_push(message(0)))
            accepted = stack.enter_context(hung.accept()[0])
            assert accepted.recv(4)
