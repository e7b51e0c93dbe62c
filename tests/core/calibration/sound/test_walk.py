"""Offsets of a walk's videos by their sound, as cameras encode it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from streamlod.core.arrays import Float64
from streamlod.core.calibration.sound.alike import RATE
from streamlod.core.calibration.sound.walk import unlike_clocks, walk_offsets
from streamlod.core.calibration.walk import open_walk
from tests.clicks import write_sounding
from tests.core.calibration.sound.claps import claps
from tests.core.data.writers import picture, write_video

SECONDS = 14
PICTURES = [np.full((32, 48, 3), 90, np.uint8)] * (25 * SECONDS)


def offsets_of(folder: Path, sounds: dict[str, NDArray[np.int16] | None], suffix: str = ".mp4") -> Float64:
    """By sound, of cameras that record these samples; None for no sound at all."""
    for name, sound in sounds.items():
        if sound is None:
            write_video(folder / f"{name}{suffix}", PICTURES, 25)
        else:
            write_sounding(folder / f"{name}{suffix}", SECONDS, rate=RATE, pictures=PICTURES, sound=sound)
    return walk_offsets(open_walk(folder))


@pytest.mark.parametrize(("begin", "suffix"), [(0.3, ".mp4"), (-0.72, ".mkv"), (3.7, ".mov"), (-5.25, ".mp4")])
def test_videos_begun_one_after_the_other_are_brought_to_one_time(tmp_path: Path, begin: float, suffix: str) -> None:
    """Though each records the hand that starts and stops it, louder than the claps, at the same place of its file."""
    at = (5.1, 6.45, 7.2)
    sounds = {
        "a": claps(0.0, SECONDS, 1, gain=0.5, touched=20_000, at=at),
        "b": claps(begin, SECONDS, 2, gain=0.3, touched=20_000, at=at),
    }
    assert offsets_of(tmp_path, sounds, suffix) == pytest.approx([0.0, begin], abs=0.004)


def test_cameras_that_are_mute_dead_or_deafened_are_left_out(tmp_path: Path) -> None:
    at = (6.1, 8.45, 9.2)
    sounds = {
        "dead": np.zeros((SECONDS * RATE, 1), np.int16),
        "far": claps(1.4, SECONDS, 1, gain=0.2, at=at),
        "loud": claps(0.0, SECONDS, 2, gain=0.0, noise=6000.0),
        "mute": None,
        "near": claps(0.0, SECONDS, 3, at=at),
    }
    found = offsets_of(tmp_path, sounds)
    assert np.isnan(found).tolist() == [True, False, True, True, False]
    assert found[1] - found[4] == pytest.approx(1.4, abs=0.004)


def test_silence_tells_nothing(tmp_path: Path) -> None:
    silent = {name: claps(0.0, SECONDS, n, at=()) for n, name in enumerate("ab")}
    assert np.isnan(offsets_of(tmp_path, silent)).all()


def test_files_on_one_clock_and_damaged_sound_are_not_listened_to(tmp_path: Path) -> None:
    """The clock of files that a rig recorded is better than sound, which takes 3 ms a metre."""
    write_video(tmp_path / "a.mp4", [picture(0, 0)] * 10, comment="times are of one clock for all cameras")
    write_sounding(tmp_path / "b.mp4", 2.0)
    one, other = open_walk(tmp_path)
    assert (one.sound, other.sound) == (None, tmp_path / "b.mp4")
    (tmp_path / "b.mp4").write_bytes(b"no video")
    assert np.isnan(walk_offsets([one, other])).all()


def test_clocks_that_agree_within_half_a_frame_and_the_way_of_sound_stay(tmp_path: Path) -> None:
    for name in "abc":
        write_video(tmp_path / f"{name}.mp4", [picture(0, 0)] * 10, 25)
    footage = open_walk(tmp_path)
    assert unlike_clocks(footage, np.array([0.0, 0.029, np.nan])).tolist() == [0, 0, 0]
    assert unlike_clocks(footage, np.array([0.0, 0.031, np.nan])).tolist() == [0, 0.031, 0]
    assert unlike_clocks(footage, np.full(3, np.nan)).tolist() == [0, 0, 0]
