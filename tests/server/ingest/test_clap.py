"""`streamlod check rig.json` where several cameras are heard."""

from __future__ import annotations

import json
import re
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from streamlod.core.calibration.sound.alike import RATE
from streamlod.server.cli.check import check
from streamlod.server.settings import Settings
from tests.clicks import write_sounding
from tests.core.calibration.sound.claps import claps
from tests.server.ingest.rig import FPS, HEIGHT, NEEDS_FFMPEG, WIDTH, burnt, sending, write_definition
from tests.server.ports import free_ports

SECONDS = 20
AT = (1.5, 3.1, 4.47, 6.0, 7.9, 9.1, 10.8, 12.2, 13.3, 15.7, 17.0, 18.9)  # wherever listening begins, some follow
ASKED = "clap once, loudly, where {} hear it: within 10 s"


def write_heard(path: Path, seed: int, late: float = 0.0, gain: float = 1.0) -> None:
    """A camera's file, in which it sees and hears everything so many seconds late."""
    pictures = [burnt(0)] * (FPS * SECONDS)
    sound = claps(-late, SECONDS, seed, gain=gain, at=AT)
    write_sounding(path, SECONDS, rate=RATE, pictures=pictures, fps=FPS, sound=sound)


def checked(rig: Path) -> tuple[str, list[str]]:
    """The report, and what was said before it."""
    said: list[str] = []
    text, _ = check(rig, None, Settings(port=0), said.append)
    return text, said


@pytest.mark.long
def test_a_camera_that_is_late_is_told_what_to_write_and_then_agrees(tmp_path: Path) -> None:
    for row, late in enumerate((0.0, 1.3, 0.004)):
        write_heard(tmp_path / f"{row}.mp4", row, late)
    rig = write_definition(tmp_path, ["0.mp4", "1.mp4", "2.mp4"], size=(WIDTH, HEIGHT), sound="cam2")
    text, said = checked(rig)
    assert said == [ASKED.format("cam0, cam1 and cam2")]
    found = re.search(r"cam1 hears the same (\d+) ms later .* add (-\d+) to its offset_ms in rig\.json", text)
    assert found is not None, text
    assert int(found[2]) == pytest.approx(-1300, abs=5)
    value = json.loads(rig.read_text())
    value["cameras"][1]["offset_ms"] = int(found[2])
    rig.write_text(json.dumps(value))
    text, _ = checked(rig)
    assert "hears the same" not in text
    assert "by what cam0, cam1 and cam2 heard, their times agree to" in text


@pytest.mark.long
def test_nothing_is_waited_for_where_one_alone_hears_and_silence_is_told(tmp_path: Path) -> None:
    write_heard(tmp_path / "0.mp4", 0)
    write_heard(tmp_path / "1.mp4", 1, gain=0.0)
    write_sounding(tmp_path / "2.mkv", SECONDS, pictures=[burnt(0)] * (FPS * SECONDS), sound=np.zeros((0, 1), np.int16))
    text, said = checked(write_definition(tmp_path, ["0.mp4", "2.mkv"], size=(WIDTH, HEIGHT)))
    assert said == []
    assert "heard" not in text
    text, said = checked(write_definition(tmp_path, ["0.mp4", "1.mp4"], size=(WIDTH, HEIGHT)))
    assert said == [ASKED.format("cam0 and cam1")]
    assert "of cam0 and cam1 no two heard the same, such as a clap" in text


@pytest.mark.long
@NEEDS_FFMPEG
def test_cameras_that_send_sound_beside_their_pictures_are_compared(tmp_path: Path) -> None:
    ports = free_ports(2)
    rig = write_definition(tmp_path, [f"tcp+listen://127.0.0.1:{port}" for port in ports], size=(WIDTH, HEIGHT))
    with ExitStack() as stack:
        for row, port in enumerate(ports):
            write_heard(tmp_path / f"{row}.mp4", row)
            to = ("-f", "mpegts", f"tcp://127.0.0.1:{port}")
            stack.enter_context(sending(tmp_path / f"{row}.mp4", to, again=True))
        text, said = checked(rig)
    assert said == [ASKED.format("cam0 and cam1")]
    assert "by what cam0 and cam1 heard, their times agree to" in text
