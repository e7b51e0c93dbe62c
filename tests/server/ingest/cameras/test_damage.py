"""What a live camera loses on the way costs pictures, and never gives wrong ones."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import av
import numpy as np
import pytest

from streamlod.core.arrays import UInt8
from streamlod.server.ingest.cameras import live_decoding
from streamlod.server.ingest.cameras.address import parse_address
from streamlod.server.ingest.cameras.reader import Reader
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.timeline import Timeline
from tests.core.data.writers import write_video
from tests.server.ingest.rig import NEEDS_FFMPEG, sending
from tests.server.ports import free_ports
from tests.waiting import wait

SIZE, COUNT = (192, 128), 84
TS = 188
X264 = "threads=1:scenecut=0:keyint=12:min-keyint=12:bframes=0"


class Hasty(Timeline):
    """A second goes by each time it is asked, as pictures of a connection's first second are not used."""

    def now_ns(self) -> int:
        self.start_ns = getattr(self, "start_ns", super().now_ns()) + 1_000_000_000
        return self.start_ns


class Shown:
    """A reader's sink that keeps the pictures, until the source ends."""

    def __init__(self) -> None:
        self.images: list[UInt8] = []
        self.before: list[str] = []  # what was told before the first
        self.ended = threading.Event()

    def put(self, picture: Picture) -> None:
        self.images.append(np.array(picture.load()))

    def gone(self, camera: str, reason: str, *, ended: bool) -> None:
        if self.images:
            self.ended.set()
        else:
            self.before.append(reason)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Small squares that move, so that what is built upon damage shows it."""
    squares = np.random.default_rng(5).integers(0, 256, (16, 24, 3)).astype(np.uint8)
    whole = squares.repeat(8, 0).repeat(8, 1)
    path = tmp_path_factory.mktemp("clip") / "clip.ts"
    images = [np.roll(whole, 3 * number, 1) for number in range(COUNT)]
    write_video(path, images, codec="libx264", options={"preset": "fast", "x264-params": X264})
    return path


def _numbers(clip: Path, images: list[UInt8]) -> list[int]:
    """Which picture of the clip each is; -1 where it is none of them, bit by bit."""
    with av.open(str(clip)) as container:
        clean = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    return [next((n for n, whole in enumerate(clean) if np.array_equal(image, whole)), -1) for image in images]


def _read(address: str) -> Shown:
    shown = Shown()
    reader = Reader("cam0", parse_address(address), SIZE, 30.0, shown, Hasty(), anchor_ns=0)
    reader.start()
    try:
        wait(shown.ended.is_set, 60)
    finally:
        reader.stop()
        reader.join(60)
    return shown


@contextmanager
def _served(data: bytes) -> Iterator[str]:
    """The address of a camera that sends `data` to the first who connects, and hangs up."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def send() -> None:
            with suppress(OSError), server.accept()[0] as connection:
                connection.sendall(data)

        thread = threading.Thread(target=send)
        thread.start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
    thread.join(60)


@pytest.mark.parametrize("lost", [0, 1, 3])
def test_what_is_built_upon_lost_packets_is_missing_up_to_the_next_keyframe(clip: Path, lost: int) -> None:
    with av.open(str(clip)) as container:
        at = [packet.pos for packet in container.demux(video=0) if packet.size > 0][63] + TS
    data = clip.read_bytes()
    with _served(data[:at] + data[at + TS * lost :]) as address:
        numbers = _numbers(clip, _read(address).images)
    assert -1 not in numbers
    assert {*range(48, 62), *range(72, COUNT - 1)} <= set(numbers)  # the first are gone with finding out what it is
    assert (63 in numbers) == (lost == 0)


def test_a_camera_that_is_joined_long_before_a_keyframe_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One connection is enough; another would miss the keyframe as well. What is waited for is said."""
    monkeypatch.setattr(live_decoding, "_USUAL_SECONDS", 0.0)
    path, first = tmp_path / "long.ts", 60
    images = [np.full((*SIZE[::-1], 3), 20 + 2 * number, np.uint8) for number in range(COUNT)]
    write_video(path, images, codec="libx264", options={"x264-params": X264.replace("12", str(first))})
    with av.open(str(path)) as container:
        at = [packet.pos for packet in container.demux(video=0) if packet.size > 0][8]
    with _served(path.read_bytes()[at:]) as address:
        shown = _read(address)
    assert [reason for reason in shown.before if "keyframe" in reason] == [
        "sent no keyframe within 0 s; set it to send one each second or two"
    ]
    numbers = _numbers(path, shown.images)
    assert set(range(first + 1, COUNT - 1)) <= set(numbers)


class Lossy:
    """A relay before a camera's RTSP connection that keeps back one in so many of the packets amid a picture.

    A picture that is lost as a whole is not noticed: the decoder marks nothing.
    """

    def __init__(self, to: int, each: int) -> None:
        self._to, self._each = to, each
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port, self.lost = self._server.getsockname()[1], 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._server.close()
        self._thread.join(60)

    def _run(self) -> None:
        with suppress(OSError), self._server.accept()[0] as sender, wait(self._connected) as on:
            back = threading.Thread(target=self._answers, args=(on, sender))
            back.start()
            count, came = 0, sender.makefile("rb")
            while head := came.read(1):
                if head != b"$":  # a line of a request
                    on.sendall(head + came.readline())
                    continue
                head += came.read(3)
                packet = came.read(int.from_bytes(head[2:], "big"))
                amid = head[1] == 0 and packet[12] & 31 == 28 and not packet[13] & 0xC0  # RFC 6184: neither end
                count += amid
                if amid and count % self._each == 0:
                    self.lost += 1
                else:
                    on.sendall(head + packet)
            on.shutdown(socket.SHUT_RDWR)
            back.join(60)

    def _connected(self) -> socket.socket | None:
        with suppress(ConnectionRefusedError):  # the reader does not listen yet
            return socket.create_connection(("127.0.0.1", self._to))
        return None

    @staticmethod
    def _answers(on: socket.socket, sender: socket.socket) -> None:
        with suppress(OSError):
            while data := on.recv(1 << 16):
                sender.sendall(data)


@pytest.mark.long
@NEEDS_FFMPEG
def test_an_rtsp_camera_that_loses_packets_gives_no_wrong_picture(clip: Path) -> None:
    (port,) = free_ports(1)
    relay = Lossy(port, each=31)
    output = ("-f", "rtsp", "-rtsp_transport", "tcp", "-pkt_size", "200", f"rtsp://127.0.0.1:{relay.port}/cam")
    with sending(clip, output, again=False):
        numbers = _numbers(clip, _read(f"rtsp+listen://127.0.0.1:{port}/cam").images)
    relay.close()
    assert relay.lost > 0
    assert -1 not in numbers
    assert len(numbers) > 12
