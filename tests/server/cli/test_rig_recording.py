"""`streamlod rig --record`: recordings of a rig before it is calibrated."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from streamlod.codec.sound.beside import RECORDED, look_at_sound
from streamlod.core.calibration.walk import open_walk
from streamlod.core.data.video.file import probe_video, read_video
from streamlod.core.errors import InputError
from streamlod.server.auth.gate import hash_token
from streamlod.server.cli.rig import watch
from streamlod.server.ingest import recording
from streamlod.server.settings import Settings
from tests.clicks import heard_at, write_sounding
from tests.core.data.writers import write_video
from tests.server.cli.filming import FPS, SKEW_NS, film, found, write_still
from tests.server.ingest.rig import HEIGHT, WIDTH, burnt, number_of, write_definition
from tests.small_disk import files_up_to
from tests.waiting import wait


@pytest.mark.long
def test_phones_are_recorded_on_one_clock(tmp_path: Path) -> None:
    """Each has a link of its own, as tokens are needed; the files tell when pictures were taken to a tenth of a ms."""
    rig, tokens = tmp_path / "rig.json", tmp_path / "tokens.json"
    tokens.write_text(json.dumps([{"name": "a", "sha256": hash_token("a"), "rights": ["read"], "streams": "*"}]))
    found(tmp_path, str(write_still(tmp_path / "still.mp4")), phones=2)
    said: list[str] = []
    over, begin = threading.Event(), time.time_ns()
    phones: list[threading.Thread] = []
    answers: dict[str, list[dict[str, Any]]] = {"phone1": [], "phone2": []}

    def say(line: str) -> None:
        said.append(line)
        if match := re.search(r"(phone\d): (http\S+)$", line):
            work = (match[2], match[1], begin, over, answers[match[1]])
            phones.append(threading.Thread(target=film, args=work, daemon=True))
            phones[-1].start()

    settings = Settings(port=0, tokens=tokens)
    watch(rig, tmp_path / "walk", 3.0, settings, say, overwrite=False)
    over.set()
    for phone in phones:
        phone.join(60)
        assert not phone.is_alive()
    assert len(phones) == 2
    for name, told in answers.items():
        assert {each["name"] for each in told} == {name}
        assert "board" not in told[0], "nothing is recorded yet"
        assert told[-1]["board"] == {"seen": False, "needs": "not seen yet"}
    assert any("all 3 cameras at one instant" in line for line in said)
    assert f"next: streamlod calibrate {tmp_path / 'walk'}" in said[-1]
    with pytest.raises(InputError, match="not empty"):
        watch(rig, tmp_path / "walk", 3.0, settings, say, overwrite=False)
    assert all(probe_video(file).one_clock for file in (tmp_path / "walk").glob("*.mp4"))
    footage = {each.camera: each for each in open_walk(tmp_path / "walk")}
    assert footage.keys() == {"cam1", "phone1", "phone2"}
    starts = []
    for name in ("phone1", "phone2"):
        numbers = [number_of(picture) for picture in footage[name].pictures() if picture is not None]
        assert len(numbers) > 10
        offsets = footage[name].times - np.array(numbers) / FPS
        assert np.ptp(offsets) < 1e-4
        starts.append(offsets[0])
    assert abs(starts[1] - starts[0] - SKEW_NS / 1e9) < 1e-4


@pytest.mark.long
def test_what_was_recorded_is_there_where_the_recorder_was_killed(tmp_path: Path) -> None:
    write_video(tmp_path / "film.mp4", [burnt(number) for number in range(300)], fps=FPS)
    rig, folder = write_definition(tmp_path, ["film.mp4"] * 2), tmp_path / "walk"
    command = [sys.executable, "-m", "streamlod.server.cli", "rig", str(rig), "--record", str(folder)]

    def recorded() -> int:
        try:
            return min(probe_video(folder / f"cam{number}.mp4").frame_count for number in range(2))
        except InputError:
            return 0

    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            wait(lambda: process.poll() is not None or recorded() > FPS, 60)
        finally:
            process.kill()
    assert process.returncode == -signal.SIGKILL
    footage, _ = open_walk(folder)
    numbers = [number_of(picture) for picture in footage.pictures() if picture is not None]
    assert FPS < len(numbers) < 250, "of 300"
    assert np.ptp(footage.times - np.array(numbers) / FPS) < 1e-4


@pytest.mark.long
def test_sound_is_recorded_on_the_clock_of_the_pictures(tmp_path: Path) -> None:
    write_sounding(tmp_path / "film.mp4", 9.0)
    folder, said = tmp_path / "walk", list[str]()
    rig = write_definition(tmp_path, ["film.mp4"] * 2, size=(96, 64), sound="cam1")
    watch(rig, folder, 5.0, Settings(), said.append, overwrite=False)
    assert any(re.fullmatch(r".*sound\.opus: [45] s of sound of cam1", line) for line in said), said
    assert look_at_sound(folder / RECORDED).camera == "cam1"
    with closing(read_video(folder / "cam0.mp4")) as pictures:
        bright = [(time_ns / 1e9, picture.to_ndarray(format="gray").mean() > 128) for time_ns, picture in pictures]
    flashes = [time for (time, is_bright), (_, before) in zip(bright[1:], bright, strict=False) if is_bright > before]
    clicks = heard_at(folder / RECORDED)
    assert len(flashes) > 2
    assert all(min(abs(click - flash) for click in clicks) < 0.04 for flash in flashes[:-1]), (flashes, clicks)


@pytest.mark.long
def test_sound_that_does_not_come_is_told(tmp_path: Path) -> None:
    write_video(tmp_path / "mute.mp4", [burnt(number) for number in range(100)], fps=FPS)
    rig, said = write_definition(tmp_path, ["mute.mp4"], sound="cam0"), list[str]()
    (tmp_path / "walk").mkdir()
    (tmp_path / "walk" / RECORDED).write_bytes(b"of an earlier walk")
    watch(rig, tmp_path / "walk", 2.0, Settings(), said.append, overwrite=True)
    assert "no sound was recorded: nothing came of cam0" in said
    assert not (tmp_path / "walk" / RECORDED).exists()


def test_a_walk_that_cannot_be_written_any_more_ends_at_once(tmp_path: Path) -> None:
    """Nobody walks for a minute in vain; the fault names the file."""
    write_video(tmp_path / "still.mp4", [burnt(0)] * (40 * FPS), fps=FPS)
    rig, begin = write_definition(tmp_path, ["still.mp4"]), time.monotonic()
    with ExitStack() as disk:

        def fill(said: str) -> None:
            if said.startswith("recording"):
                disk.enter_context(files_up_to(500))

        with pytest.raises(InputError, match=r"walk/cam0\.mp4: cannot be written"):
            watch(rig, tmp_path / "walk", 40.0, Settings(), fill, overwrite=False)
    assert time.monotonic() - begin < 30


@pytest.mark.long
def test_a_camera_slower_than_the_rig_is_named_while_it_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two such cameras might never film at one instant, and nobody would know why."""
    monkeypatch.setattr(recording, "_TELL_SECONDS", 0.8)
    write_video(tmp_path / "slow.mp4", [np.zeros((HEIGHT, WIDTH, 3), np.uint8)] * 50, fps=5)
    rig, said = write_definition(tmp_path, ["slow.mp4"]), list[str]()
    watch(rig, tmp_path / "walk", 3.0, Settings(), said.append, overwrite=False)
    assert said[-3] == "the board: no camera has seen it, which is to have 7x5 squares of 55 mm", said
    slow = r"trouble with cam0 \([345] a second, but the rig wants "
    assert any(re.match(slow, line) for line in said), said


@pytest.mark.long
def test_a_phone_that_was_away_is_not_called_slow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It films as fast as it should, but its connection breaks every two seconds, for 1.2 s."""
    monkeypatch.setattr(recording, "_TELL_SECONDS", 2.0)
    fps, said, over, phones = 5, list[str](), threading.Event(), list[threading.Thread]()

    def film_with_breaks(page: str) -> None:
        while not over.is_set():
            hangs_up = threading.Event()
            threading.Timer(2.0, hangs_up.set).start()
            film(page, "cam0", time.time_ns(), hangs_up, fps=fps)
            over.wait(1.2)

    def say(line: str) -> None:
        said.append(line)
        if match := re.search(r"each phone: (http\S+)$", line):
            phones.append(threading.Thread(target=film_with_breaks, args=(match[1],), daemon=True))
            phones[-1].start()

    rig = write_definition(tmp_path, ["push:"], fps=fps)
    watch(rig, tmp_path / "walk", 12.0, Settings(port=0), say, overwrite=False)
    over.set()
    phones[0].join(60)
    assert not phones[0].is_alive()
    assert any(re.match(r"trouble with cam0 \((?!\d)", line) for line in said), "it was away when that was asked"
    assert not any("a second" in line for line in said), said


def test_a_damaged_description_of_the_board_is_told_before_anything_is_waited_for(tmp_path: Path) -> None:
    (tmp_path / "charuco.toml").write_text("columns = ")
    with pytest.raises(InputError, match=r"charuco\.toml"):
        watch(write_definition(tmp_path, ["push:"]), tmp_path / "walk", 3.0, Settings(), print, overwrite=False)
    assert not (tmp_path / "walk").exists()
