"""What a reader tells about a camera before its first picture."""

from __future__ import annotations

import socket
import time
from pathlib import Path

from streamlod.server.ingest.cameras.address import parse_address
from streamlod.server.ingest.cameras.reader import Reader
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.timeline import Timeline
from tests.attack.test_http_cameras import Faults
from tests.core.data.writers import write_video
from tests.server.ingest.rig import HEIGHT, WIDTH, burnt
from tests.server.ingest.together import load_together
from tests.server.ports import free_ports

LOADS = 200  # of a picture: without a lock every run hung or crashed


class Kept(Faults):
    """Keeps all pictures."""

    def __init__(self) -> None:
        super().__init__()
        self.pictures: list[Picture] = []

    def put(self, picture: Picture) -> None:
        self.pictures.append(picture)


def test_a_reader_that_listens_says_so_as_soon_as_cameras_may_connect() -> None:
    (port,) = free_ports(1)
    sink = Faults()
    address = parse_address(f"tcp+listen://127.0.0.1:{port}")
    reader = Reader("cam0", address, (64, 48), 10.0, sink, Timeline(), anchor_ns=0)
    reader.start()
    limit = time.monotonic() + 60
    while not sink.reasons:
        assert time.monotonic() < limit
        time.sleep(0.005)
    assert sink.reasons[0].startswith("listening")
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), 1).close()
            break
        except ConnectionRefusedError:
            assert time.monotonic() < limit
            time.sleep(0.02)
    reader.stop()
    reader.join(60)


def test_several_threads_may_load_one_picture(tmp_path: Path) -> None:
    """FFmpeg's conversion of one frame by two threads at once never comes back."""
    write_video(tmp_path / "a.mp4", [burnt(number) for number in range(4)])
    sink = Kept()
    address = parse_address(f"file://{tmp_path}/a.mp4")
    reader = Reader("cam0", address, (WIDTH, HEIGHT), 10.0, sink, Timeline(), anchor_ns=0, paced=False)
    reader.start()
    reader.join(60)
    assert len(sink.pictures) == 4
    assert load_together(sink.pictures, LOADS)
