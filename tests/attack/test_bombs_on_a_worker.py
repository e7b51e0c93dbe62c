"""Picture bombs pushed to a rig in a process of its own, as a worker has it: it takes no memory for them and lives on.

There is no separate process that decodes. What the header announces is checked before a decoder sees a picture, and
decoders allocate by that same header, so the rig's process has a bound for every picture: see test_picture_costs.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest

from streamlod.core.errors import InputError, SessionError
from streamlod.server.ingest.push.message import Codec, PushMessage
from tests.attack.test_picture_bombs import encoded, hidden_behind, with_size
from tests.attack.test_picture_costs import with_pixels
from tests.server.ingest.push.serving import relayed

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
SIZE = (240, 136)
_RIG = """
import json, sys
from pathlib import Path
from streamlod.server.ingest.live import open_live
for frame in open_live(json.loads(sys.argv[1]), push_socket=Path(sys.argv[2])).frames():
    print(frame.index, int(frame.present.sum()), flush=True)
"""
_ROOM = 40 << 20  # bytes: some pictures of this size in every stage


def definition() -> dict[str, object]:
    identity = np.eye(4).tolist()
    camera = {"source": "push:", "width": SIZE[0], "height": SIZE[1], "world_to_camera": identity}
    matrix = [[200, 0, SIZE[0] / 2], [0, 200, SIZE[1] / 2], [0, 0, 1]]
    cameras = [{"name": name, "intrinsics": matrix, **camera} for name in ("good", "bad")]
    return {"fps": 10, "policy": {"quorum": 1}, "cameras": cameras}


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """The process, and where it takes pictures."""
    command = [sys.executable, "-c", _RIG, json.dumps(definition()), str(tmp_path / "s")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield process, tmp_path / "s"
        process.kill()


def peak_bytes(pid: int) -> int:
    """Most memory that a process ever had resident."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return 1024 * int(line.split()[1])
    raise AssertionError("there is no VmHWM")


def h264(width: int, height: int) -> bytes:
    """One whole picture as an access unit."""
    context = av.CodecContext.create("libx264", "w")
    assert isinstance(context, av.VideoCodecContext)
    context.width, context.height, context.pix_fmt, context.framerate = width, height, "yuv420p", 10
    context.options = {"preset": "ultrafast", "tune": "zerolatency"}
    frame = av.VideoFrame(width, height, "yuv420p")
    for plane in frame.planes:
        plane.update(bytes(plane.buffer_size))
    frame.pts = 0
    return b"".join(bytes(packet) for packet in [*context.encode(frame), *context.encode()])


def bombs() -> dict[str, tuple[Codec, bytes]]:
    """Small messages that ask for much memory, by what they are."""
    found: dict[str, tuple[Codec, bytes]] = {}
    whole = encoded(".jpg")
    for side in (20_000, 30_000, 65_500):
        hidden = hidden_behind(b"\xff\x01")
        at = hidden.rindex(b"\xff\xc0") + 5
        found[f"JPEG of {side} squared behind FF01"] = (
            Codec.JPEG,
            hidden[:at] + struct.pack(">HH", side, side) + hidden[at + 4 :],
        )
        found[f"JPEG of {side} squared"] = Codec.JPEG, with_size(whole, side, side)
        png = bytearray(encoded(".png"))
        png[16:24] = struct.pack(">II", side, side)
        found[f"PNG of {side} squared"] = Codec.PNG, bytes(png)
    found["PNG that unpacks to 200 MB"] = Codec.PNG, with_pixels(200_000_000, SIZE)
    found["H.264 of 4096x4096"] = Codec.H264, h264(4096, 4096)
    return found


class Camera(threading.Thread):
    """Pushes an honest picture ten times a second until the rig ends."""

    def __init__(self, path: Path) -> None:
        super().__init__(daemon=True)
        self._intake, self._picture = relayed(path), encoded(".jpg", SIZE)
        self.start()

    def run(self) -> None:
        with contextlib.suppress(SessionError):
            for number in itertools.count():
                self._intake.accept(PushMessage("good", number, time.time_ns(), Codec.JPEG, self._picture))
                time.sleep(0.1)
        self._intake.close()


@pytest.mark.long
def test_bombs_neither_end_a_rig_nor_take_memory(rig: tuple[subprocess.Popen[str], Path]) -> None:
    process, path = rig
    assert process.stdout is not None
    Camera(path)
    intake = relayed(path)
    while not process.stdout.readline().endswith(" 1\n"):  # it delivers
        pass
    before, refused, sent = peak_bytes(process.pid), list[str](), bombs()
    for number, (name, (codec, body)) in enumerate(sent.items()):
        try:
            intake.accept(PushMessage("bad", number, time.time_ns(), codec, body))
        except InputError as error:
            refused.append(f"{name}: {error.fault}")
        process.stdout.readline()  # by now the picture was decoded, if it was taken
        assert process.poll() is None, name
        assert peak_bytes(process.pid) < before + _ROOM, name
    assert len(refused) == len(sent) - 1, refused  # the PNG is taken, but not unpacked further than announced
    while not process.stdout.readline().endswith(" 1\n"):  # it goes on with the camera that is honest
        pass
    intake.close()
