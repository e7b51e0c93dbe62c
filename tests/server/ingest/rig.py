"""Fake cameras: clips whose pictures carry their number in black and white blocks, sent by real ffmpeg processes."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import av
import numpy as np
import pytest

from streamlod.core.arrays import UInt8

FPS, WIDTH, HEIGHT = 30, 160, 128
_BITS, _ROWS = 16, 16
NEEDS_FFMPEG = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="fake cameras need the command ffmpeg")


def write_clip(path: Path, seconds: int) -> None:
    """A clip with a keyframe twice a second, and every picture's number burnt in."""
    options = {"preset": "ultrafast", "tune": "zerolatency", "g": "15", "bf": "0", "crf": "30", "sc_threshold": "0"}
    with av.open(str(path), "w", format="mpegts") as container:
        stream = container.add_stream("libx264", rate=FPS, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for number in range(seconds * FPS):
            frame = av.VideoFrame.from_ndarray(burnt(number), format="rgb24")
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def burnt(number: int) -> UInt8:
    """[H,W,3] a picture that carries its number."""
    grey = np.full((HEIGHT, WIDTH), 40 + number % 150, np.uint8)
    code = [235 if number >> bit & 1 else 16 for bit in range(_BITS)]
    grey[:_ROWS] = np.repeat(np.array(code, np.uint8), WIDTH // _BITS)
    return np.repeat(grey[:, :, None], 3, axis=2)


def number_of(image: UInt8) -> int:
    """The number that a picture carries."""
    block = WIDTH // _BITS
    return sum(1 << bit for bit in range(_BITS) if image[4:12, bit * block + 3 : (bit + 1) * block - 3].mean() > 128)


def write_definition(
    folder: Path,
    sources: list[str],
    policy: object = "require_all",
    *,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    **fields: object,
) -> Path:
    """A rig's file for cameras that see fake clips."""
    width, height = size
    cameras = [
        {
            "name": f"cam{row}",
            "source": source,
            "width": width,
            "height": height,
            "intrinsics": [[150, 0, width / 2], [0, 150, height / 2], [0, 0, 1]],
            "world_to_camera": [[1, 0, 0, 0.1 * row], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]],
        }
        for row, source in enumerate(sources)
    ]
    path = folder / "rig.json"
    path.write_text(json.dumps({"fps": FPS, "policy": policy, "cameras": cameras, **fields}))
    return path


class Sender:
    """One fake camera: an ffmpeg process that plays a clip in real time.

    Args:
        again: begin anew when the other end hangs up or is not there yet, as cameras do.
    """

    def __init__(self, clip: Path, *output: str, before: tuple[str, ...] = (), again: bool = False) -> None:
        self._command = [
            *("ffmpeg", "-nostdin", "-loglevel", "error", "-re", *before, "-i", str(clip), "-c", "copy", *output)
        ]
        self._dead = threading.Event()
        self._process = self._spawn()
        if again:
            threading.Thread(target=self._respawn, daemon=True).start()

    def pause(self) -> None:
        """Stop it, as a camera hangs."""
        os.kill(self._process.pid, signal.SIGSTOP)

    def resume(self) -> None:
        """Let it go on, with all that it should have sent at once."""
        os.kill(self._process.pid, signal.SIGCONT)

    def kill(self) -> None:
        """End it, as a camera loses power."""
        self._dead.set()
        self._process.kill()
        self._process.wait()

    def _spawn(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(self._command, stderr=subprocess.DEVNULL)

    def _respawn(self) -> None:
        while not self._dead.wait(0.5):
            if self._process.poll() is not None:
                self._process = self._spawn()
        self._process.kill()
        self._process.wait()


@contextmanager
def sending(
    clip: Path, *outputs: tuple[str, ...], before: Mapping[int, tuple[str, ...]] | None = None, again: bool = False
) -> Iterator[list[Sender]]:
    """Fake cameras, one an output, killed at the end."""
    senders = [
        Sender(clip, *output, before=(before or {}).get(row, ()), again=again) for row, output in enumerate(outputs)
    ]
    try:
        yield senders
    finally:
        for sender in senders:
            sender.kill()


def rtsp(port: int) -> tuple[str, ...]:
    """Arguments of ffmpeg that push by RTSP."""
    return ("-f", "rtsp", "-rtsp_transport", "tcp", f"rtsp://127.0.0.1:{port}/live")
