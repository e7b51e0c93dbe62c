from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from streamlod.codec.sound.beside import RECORDED, look_at_sound, sound_beside
from streamlod.codec.sound.opus import SAMPLE_RATE, write_sound
from streamlod.core.calibration.checks.heard import judged
from streamlod.core.data import Dataset, open_dataset
from streamlod.core.errors import InputError
from streamlod.server.pipeline.sound import choose_sound, loudness_rises, sound_faults, write_beside
from tests.clicks import clicks, onsets, write_sounding
from tests.core.data.writers import picture, write_video, write_video_clip
from tests.opus import read_sound


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Three cameras, of which cam01 and cam02 have sound, and a recorder's file."""
    folder = tmp_path_factory.mktemp("sounding")
    write_video_clip(folder, ["cam00", "cam01", "cam02"], 3)
    write_video(folder / "cam00.mp4", [picture(0, 0)] * 75, 25)
    for name, begin in ("cam01", 0.0), ("cam02", 0.5):
        write_sounding(folder / f"{name}.mp4", 3.0, channels=1 if begin else 2, begin=begin)
    write_sounding(folder / "recorder.wav", 3.0, "pcm_s16le", pictures=False)
    return open_dataset(folder)


def test_the_first_camera_with_sound_is_taken_unless_told_otherwise(dataset: Dataset) -> None:
    folder = dataset.recording.path
    chosen = {choice: choose_sound(dataset, choice) for choice in ("auto", "none", "cam02", f"{folder}/recorder.wav")}
    assert {choice: found and found.film.path.name for choice, found in chosen.items()} == {
        "auto": "cam01.mp4", "none": None, "cam02": "cam02.mp4", f"{folder}/recorder.wav": "recorder.wav",
    }  # fmt: skip
    assert [found and found.channels for found in chosen.values()] == [2, None, 1, 1]
    assert [found and found.camera for found in chosen.values()] == ["cam01", None, "cam02", None]


def test_what_has_no_sound_is_refused(dataset: Dataset) -> None:
    with pytest.raises(InputError, match=r"cam00\.mp4: has no sound"):
        choose_sound(dataset, "cam00")
    with pytest.raises(InputError, match="'nobody' is neither a camera nor a file; cameras are cam00, cam01, cam02"):
        choose_sound(dataset, "nobody")
    with pytest.raises(InputError, match="cannot be opened for its sound"):
        choose_sound(dataset, str(dataset.recording.path / "poses_bounds.npy"))


def test_sound_is_written_as_long_as_the_pictures_and_removed_with_them(dataset: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "clip.slod"
    write_beside(out, choose_sound(dataset, "cam02"), 2.5)
    found = look_at_sound(sound_beside(out))
    assert (found.begin_ns, found.camera) == (0, "cam02")
    samples = np.concatenate(list(read_sound(sound_beside(out))))
    assert len(samples) == round(2.5 * SAMPLE_RATE)
    assert onsets(samples) == pytest.approx([1.0, 2.0], abs=0.02)
    write_beside(out, None, 2.5)  # other pictures, and silent ones: the earlier sound is not theirs
    assert list(tmp_path.iterdir()) == []


def test_sound_that_was_recorded_with_the_rig_is_taken_on_its_clock(dataset: Dataset, tmp_path: Path) -> None:
    for path in dataset.recording.path.iterdir():
        shutil.copy(path, tmp_path)
    write_sound(tmp_path / RECORDED, [clicks(2.0, begin=0.75)], 1, 750_000_000, "cam02")
    beside = open_dataset(tmp_path)
    for choice in ("auto", str(tmp_path / RECORDED)):
        found = choose_sound(beside, choice)
        assert found is not None
        assert (found.film.path.name, found.camera) == (RECORDED, "cam02")
        write_beside(tmp_path / "clip.slod", found, 3.0)
        samples = np.concatenate(list(read_sound(tmp_path / "clip.slod.opus")))
        assert onsets(samples) == pytest.approx([1.0, 2.0], abs=0.02)
    (tmp_path / RECORDED).write_bytes(b"OggS, cut off")
    for choice in ("cam01", "auto"):  # what is damaged is passed over
        named = choose_sound(beside, choice)
        assert named is not None
        assert named.film.path.name == "cam01.mp4"


def test_flash_and_click_have_one_time(dataset: Dataset, tmp_path: Path) -> None:
    """The frames that train, and so the packets, carry the time at which the sound beside them clicks."""
    write_beside(tmp_path / "clip.slod", choose_sound(dataset, "cam01"), 3.0)
    clicked = onsets(np.concatenate(list(read_sound(tmp_path / "clip.slod.opus"))))
    flashed = [frame.time_ns / 1e9 for frame in dataset.select(["cam01"]).frames() if frame.images.mean() > 200]
    assert len(flashed) == 3
    assert clicked == pytest.approx(flashed, abs=0.02)


def test_a_dead_microphone_is_told_and_passed_over(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_video_clip(tmp_path, ["cam00", "cam01"], 3)
    write_sounding(tmp_path / "cam00.mp4", 3.0, without=(0.1, 3.0), begin=0.02)  # a second's end: nothing but silence
    write_sounding(tmp_path / "cam01.mp4", 3.0)
    dataset = open_dataset(tmp_path)
    dead = "no sound of cam00: it recorded silence; was it muted, or had it no power?"
    assert sound_faults(dataset) == [dead]
    chosen = choose_sound(dataset, "auto")
    assert chosen is not None
    assert chosen.film.path.name == "cam01.mp4"
    assert dead in caplog.messages
    caplog.clear()
    assert choose_sound(dataset, "cam00") is not None  # as it was named
    assert dead in caplog.messages


def test_sound_that_starts_late_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_video_clip(tmp_path, ["cam00", "cam01"], 3)
    write_sounding(tmp_path / "cam00.mp4", 4.0, begin=1.6)  # the first click is at 2 s
    write_sounding(tmp_path / "cam01.mp4", 4.0)
    dataset = open_dataset(tmp_path)
    late = "the sound of cam00 starts 2.0 s after its pictures; until then there is silence"
    assert sound_faults(dataset) == [late]
    assert choose_sound(dataset, "auto") is not None
    assert late in caplog.messages


def test_cameras_that_are_paired_wrongly_are_told_by_what_they_hear(tmp_path: Path) -> None:
    """One of three hears each click 120 ms, three pictures, later than the others."""
    write_video_clip(tmp_path, ["cam00", "cam01", "cam02", "cam03"], 3)
    write_video(tmp_path / "cam03.mp4", [picture(0, 0)] * 75, 25)  # has no sound
    for name, late in {"cam00": 0.0, "cam01": 0.12, "cam02": 0.0}.items():
        write_sounding(tmp_path / f"{name}.mp4", 3.0, late=late)
    wrong, fact = judged(loudness_rises(open_dataset(tmp_path)), 25.0)
    assert wrong.sentence == (
        "cam01 hears the same 120 ms later than most cameras, so its pictures are 3.0 frames off: walk the board again"
    )
    assert fact.sentence.startswith("by what cam00, cam01 and cam02 heard, their times agree to 120 ms")
