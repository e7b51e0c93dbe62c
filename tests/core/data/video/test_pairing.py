"""Pairing of a rig's files by their times: what is lost, late or at another rate shifts nothing."""

from __future__ import annotations

import logging
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from streamlod.core.camera.grid import rate_of
from streamlod.core.data import open_dataset
from streamlod.core.data.video import VideoInfo
from streamlod.core.data.video.pairing import nearest, paired, picked
from streamlod.core.errors import InputError
from tests.core.data.writers import copy_video, picture, read_back, write_video, write_video_clip

NAMES = ("cam00", "cam01", "cam02")
_SECOND_NS = 1_000_000_000


def _info(times_ns: list[int], declared: float = 30) -> VideoInfo:
    return VideoInfo(96, 64, rate_of(times_ns, Fraction(declared)), tuple(times_ns))


def _filmed(fps: float, count: int, start: float = 0) -> list[int]:
    return [round((start + t / fps) * _SECOND_NS) for t in range(count)]


def _rows(infos: list[VideoInfo]) -> list[list[int | None]]:
    """For each camera and instant, the number of its picture."""
    grid, numbers = paired([Path(f"cam{index}.mp4") for index in range(len(infos))], infos)
    return [
        list(picked(nearest(zip(info.times_ns, range(info.frame_count), strict=True), grid), numbers)) for info in infos
    ]


def _shown(folder: Path) -> list[list[int | None]]:
    """For each instant, the number that each camera's picture tells."""
    return [
        [read_back(image)[1] if present else None for image, present in zip(frame.images, frame.present, strict=True)]
        for frame in open_dataset(folder).frames()
    ]


def test_a_lost_picture_is_missing_and_shifts_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_video_clip(tmp_path, NAMES, frames=20)
    kept = [t for t in range(21) if t != 8]
    write_video(
        tmp_path / "cam01.mp4",
        [picture(1, t) for t in kept],
        times=[t * 1000 // 30 for t in kept],
        time_base=Fraction(1, 1000),
    )
    with caplog.at_level(logging.WARNING):
        shown = _shown(tmp_path)
    assert shown == [[t, None if t == 8 else t, t] for t in range(20)]
    assert "of 20 instants, pictures are missing in: cam01.mp4 at 1" in caplog.text
    assert open_dataset(tmp_path).fps == 30


def test_a_range_of_instants_after_a_lost_picture(tmp_path: Path) -> None:
    write_video_clip(tmp_path, NAMES, frames=10)
    kept = [t for t in range(10) if t != 4]
    write_video(tmp_path / "cam02.mp4", [picture(2, t) for t in kept], times=kept)
    frames = list(open_dataset(tmp_path).frames(3, 7))
    assert [frame.present.tolist() for frame in frames] == [[True, True, t != 4] for t in range(3, 7)]
    assert [read_back(frame.images[2])[1] for frame in frames if frame.present[2]] == [3, 5, 6]
    assert [frame.time_ns for frame in frames] == [round(t * 1e9 / 30) for t in range(3, 7)]


def test_cameras_that_begin_late_or_end_early_are_missing_there(tmp_path: Path) -> None:
    write_video_clip(tmp_path, NAMES, frames=10)
    write_video(tmp_path / "cam01.mp4", [picture(1, t) for t in range(3, 10)], times=list(range(3, 10)))
    write_video(tmp_path / "cam02.mp4", [picture(2, t) for t in range(7)])
    assert _shown(tmp_path) == [[t, None if t < 3 else t, None if t > 6 else t] for t in range(10)]


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_one_camera_joined_in_mid_group_and_one_cut_by_an_edit_list(tmp_path: Path, suffix: str) -> None:
    write_video_clip(tmp_path, NAMES, frames=12)
    groups = {"g": "6", "x264-params": "scenecut=0"}
    (tmp_path / "cam01.mp4").unlink()
    write_video(tmp_path / "whole.mp4", [picture(1, t) for t in range(12)], options=groups)
    copy_video(tmp_path / "whole.mp4", tmp_path / f"cam01{suffix}", skip=2)
    write_video(tmp_path / "whole.mp4", [picture(2, max(0, t - 2)) for t in range(14)], options=groups)
    copy_video(tmp_path / "whole.mp4", tmp_path / "cam02.mp4", earlier=2)
    assert _shown(tmp_path) == [[t, None if t < 6 else t, t] for t in range(12)]


def test_files_of_different_kinds_are_paired(tmp_path: Path) -> None:
    """B-frames delay what some containers say; all four cameras filmed the same."""
    write_video_clip(tmp_path, ("cam00", "cam01", "cam02", "cam03"), frames=9)
    for name in ("cam01", "cam02", "cam03"):
        (tmp_path / f"{name}.mp4").unlink()
    b_frames = {"bf": "2", "x264-params": "scenecut=0:bframes=2:b-adapt=0"}
    write_video(tmp_path / "cam01.mkv", [picture(1, t) for t in range(9)], options=b_frames)
    write_video(tmp_path / "cam02.avi", [picture(2, t) for t in range(9)], options=b_frames)
    fragments = {"movflags": "frag_keyframe+empty_moov"}
    write_video(tmp_path / "cam03.mp4", [picture(3, t) for t in range(9)], options=b_frames, muxing=fragments)
    assert _shown(tmp_path) == [[t] * 4 for t in range(9)]


def test_a_damaged_sample_costs_its_camera_the_pictures_up_to_the_next_keyframe(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_video_clip(tmp_path, NAMES, frames=16)
    groups = {"g": "6", "x264-params": "scenecut=0"}
    write_video(tmp_path / "whole.mp4", [picture(1, t) for t in range(16)], options=groups)
    (tmp_path / "cam01.mp4").unlink()
    copy_video(tmp_path / "whole.mp4", tmp_path / "cam01.mkv", damaged=8)
    assert _shown(tmp_path) == [[t, None if 8 <= t < 12 else t, t] for t in range(16)]
    assert "cam01.mkv: is damaged at 0.267 s; up to the next keyframe, 4 of its pictures are left out" in caplog.text


def test_2997_beside_30_does_not_drift() -> None:
    television = 30000 / 1001
    infos = [_info(_filmed(30, 3000)), _info(_filmed(television, 2997), television), _info(_filmed(30, 3000))]
    whole, slower, _ = _rows(infos)
    assert whole == list(range(3000))
    pairs = [(t, n) for t, n in enumerate(slower) if n is not None]
    assert max(abs(t / 30 - n / television) for t, n in pairs) <= 0.5 / 30 + 1e-6
    assert [n for _, n in pairs] == list(range(2997))  # three instants of 100 s have no picture


def test_a_camera_twice_as_fast_gives_every_other_picture() -> None:
    rows = _rows([_info(_filmed(30, 50)), _info(_filmed(60, 100), 60), _info(_filmed(30, 50))])
    assert rows[1] == list(range(0, 100, 2))


def test_variable_frame_rate() -> None:
    """A telephone that films more slowly in the dark: its pictures go where they were taken."""
    rng = np.random.default_rng(3)
    steps = rng.choice([1 / 30, 1 / 24, 1 / 15], 200, p=[0.6, 0.2, 0.2])
    seconds = np.cumsum(steps)
    variable = _info([round(s * _SECOND_NS) for s in seconds], 27.3)
    rows = _rows([_info(_filmed(30, 300)), variable, _info(_filmed(30, 300))])
    for instant, number in enumerate(rows[1]):
        if number is not None:
            assert abs(seconds[number] - instant / 30) <= 0.5 / 30 + 1e-6
    assert len([n for n in rows[1] if n is not None]) > 150


def test_steady_rates_that_do_not_belong_together_are_refused() -> None:
    files = [Path("cam00.mp4"), Path("cam01.mp4"), Path("cam02.mp4")]
    infos = [_info(_filmed(30, 60)), _info(_filmed(25, 60), 25), _info(_filmed(30, 60))]
    with pytest.raises(InputError, match=r"cam01\.mp4: runs at 25 pictures a second, but cam00\.mp4 at 30"):
        paired(files, infos)


def test_files_that_were_not_filmed_at_one_time_are_refused() -> None:
    infos = [_info(_filmed(30, 60)), _info(_filmed(30, 60, start=100))]
    with pytest.raises(InputError, match="were not filmed at one time"):
        paired([Path("clip/cam00.mp4"), Path("clip/cam01.mp4")], infos)


def test_cameras_out_of_phase_are_paired_with_the_nearest() -> None:
    """Jitter about the middle between two instants of one camera must not tear pairs apart."""
    rng = np.random.default_rng(0)
    jitter = [round(value) for value in rng.uniform(-4e6, 4e6, 100)]
    shaken = [t + j for t, j in zip(_filmed(30, 100, start=0.5 / 30), jitter, strict=True)]
    whole, other = _rows([_info(_filmed(30, 100)), _info(shaken)])
    assert len(whole) >= 99
    assert len({a - b for a, b in zip(whole, other, strict=True) if a is not None and b is not None}) == 1


def test_a_gap_beside_short_steps_is_not_counted_one_picture_longer() -> None:
    """It then ran at 26.5 pictures a second, and was refused beside cameras of 25."""
    early = {3, 4, 6, 18, 19}
    late = {1, 2, 16}
    kept = [number for number in range(20) if not 7 <= number <= 13]
    shifts = [0.15 * ((number in late) - (number in early)) for number in kept]
    times = [round((number + shift) * _SECOND_NS / 25) for number, shift in zip(kept, shifts, strict=True)]
    assert rate_of(times, Fraction(25)) == pytest.approx(25, rel=0.02)


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_loss_jitter_delay_and_coarse_clocks_never_pair_different_instants(data: st.DataObject) -> None:
    fps = data.draw(st.sampled_from([10, 24, 25, 30000 / 1001, 30, 50, 60]))
    count, infos, numbers = 20, [], []
    for _ in range(data.draw(st.integers(1, 5))):
        lost = data.draw(st.sets(st.integers(0, count - 1), max_size=7))
        tick = data.draw(st.sampled_from([1, 1000, 1_000_000]))
        amount = 0.15 * _SECOND_NS / fps
        jitter = data.draw(st.lists(st.floats(-amount, amount), min_size=count, max_size=count))
        kept = [t for t in range(count) if t not in lost]
        times = [round((t * _SECOND_NS / fps + jitter[t]) / tick) * tick for t in kept]
        numbers.append(kept)
        infos.append(_info(times, fps))
    for instant in zip(*_rows(infos), strict=True):
        seen = {numbers[camera][n] for camera, n in enumerate(instant) if n is not None}
        assert len(seen) == 1
