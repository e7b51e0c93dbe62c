"""The programs in `examples` run, as programs, against real files and a real server."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest

from streamlod import open_recording
from streamlod.core.synthetic import SyntheticSpec, write_clip
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.client.clips import states
from tests.client.clips import write_clip as write_slod
from tests.server.brief import brief_training
from tests.server.conftest import Running, make_clip, running

ROOT = Path(__file__).parents[2]


def output_of(example: str, *arguments: object) -> list[str]:
    """Lines that an example prints."""
    program = [sys.executable, str(ROOT / "examples" / f"{example}.py"), *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(program, capture_output=True, text=True, check=False, timeout=100, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("examples") / "scene.slod"
    write_slod(path, states(3))
    return path


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    clip = make_clip(tmp_path_factory.mktemp("server") / "clip.slod", frames=60, frame_ns=100_000_000)
    with running(Settings(), StreamSpec(play=clip.path, loop=True)) as server:
        server.wait(lambda stream: stream["state"] == "live")
        yield server


def test_open_recording(recording: Path) -> None:
    first, *frames, cameras = output_of("open_recording", recording)
    assert (first, len(frames)) == ("versions 0 to 2", 3)
    assert all("140 anchors" in frame for frame in frames)
    assert cameras.startswith("cameras: cam")


def test_draw_orbit(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "orbit.mp4"
    assert output_of("draw_orbit", recording, out) == [f"3 pictures in {out}"]
    assert cv2.VideoCapture(str(out)).get(cv2.CAP_PROP_FRAME_COUNT) == 3


def test_watch_stream(server: Running, tmp_path: Path) -> None:
    out = tmp_path / "picture.png"
    lines = output_of("watch_stream", f"ws://127.0.0.1:{server.port}/v1/streams/main/live", out)
    assert (lines[0], len(lines)) == ("stream main is live", 6)
    assert cv2.imread(str(out)).size > 0


def test_control_server(server: Running, recording: Path) -> None:
    lines = output_of("control_server", server.url, recording)
    assert lines[0].startswith("version ")
    assert lines[-1] == "['example', 'main']"
    with server.client() as client:
        assert client.get("/v1/streams/example").status_code == 404


@pytest.mark.long
def test_train_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_clip(SyntheticSpec(cameras=4, frames=2, width=128, height=96), tmp_path / "clip")
    out = tmp_path / "scene.slod"
    example = runpy.run_path(str(ROOT / "examples" / "train_recording.py"))
    with brief_training():  # in this process: other settings than those of a preset cannot be given from outside
        example["main"](str(tmp_path / "clip"), str(out))
    *frames, last = capsys.readouterr().out.splitlines()
    assert (frames, last[:8]) == (["frame 0", "frame 1"], "2 frames")
    assert open_recording(out).versions == (0, 1)
