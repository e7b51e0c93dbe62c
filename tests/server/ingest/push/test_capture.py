"""The pictures that a capture node finds in folders and files, in their order and upright."""

from __future__ import annotations

import itertools
import time
from pathlib import Path

import cv2
import numpy as np

from streamlod.server.ingest.push.sources import find_cameras
from tests.core.data.writers import picture, put_display_matrix, read_back, write_picture, write_video


def _numbers(folder: Path, fps: float = 200) -> list[tuple[int, int]]:
    """For each picture of the only camera: its place in time, in periods, and the number that it shows."""
    (camera,) = find_cameras([str(folder)], fps)
    start = time.time_ns()
    found = []
    for taken in camera.pictures(start):
        pixels = cv2.imdecode(np.frombuffer(taken.body, np.uint8), cv2.IMREAD_COLOR)
        assert pixels is not None
        found.append((round((taken.capture_ns - start) * fps / 1e9), read_back(np.asarray(pixels[..., ::-1]))[1]))
    return found


def test_pictures_come_in_the_order_of_their_numbers_and_hidden_ones_stay(tmp_path: Path) -> None:
    for number in range(1, 13):
        write_picture(tmp_path / "cam00" / f"frame_{number}.png", picture(0, number))
    (tmp_path / "cam00" / "._frame_1.png").write_bytes(b"of another system")
    (tmp_path / "cam00" / "folder.png").mkdir()
    assert _numbers(tmp_path) == [(t, t + 1) for t in range(12)]


def test_a_picture_that_is_missing_leaves_a_gap(tmp_path: Path) -> None:
    """Else all later ones of its camera were paired with what the others saw a picture before."""
    for number in (5, 6, 9):
        write_picture(tmp_path / "cam00" / f"{number:04d}.png", picture(0, number))
    assert _numbers(tmp_path) == [(0, 5), (1, 6), (4, 9)]
    (camera,) = find_cameras([str(tmp_path)], 200, repeats=True)
    assert camera.repeats_ns == 5 * 5_000_000


def test_cameras_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for number in (1, 2, 10):
        write_picture(tmp_path / f"cam_{number}" / "0.png", picture(0, 0))
    write_picture(tmp_path / ".hidden" / "0.png", picture(0, 0))
    assert [camera.name for camera in find_cameras([str(tmp_path)], 30)] == ["cam_1", "cam_2", "cam_10"]


def test_a_turned_video_is_pushed_upright_at_its_own_times(tmp_path: Path) -> None:
    stored = [np.rot90(picture(0, t), -1) for t in range(6)]
    write_video(tmp_path / "cam.mp4", stored, times=[0, 1, 2, 4, 5, 6], fps=200)
    put_display_matrix(tmp_path / "cam.mp4", 0, -1, 1, 0)
    assert _numbers(tmp_path) == [(0, 0), (1, 1), (2, 2), (4, 3), (5, 4), (6, 5)]
    (camera,) = find_cameras([str(tmp_path)], 200)
    body = next(camera.pictures(time.time_ns())).body
    pixels = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None
    assert pixels.shape == (64, 96, 3)
    assert np.abs(pixels[..., ::-1].astype(int) - picture(0, 0)).mean() < 4


def test_a_file_without_times_is_pushed_at_the_rate_given(tmp_path: Path) -> None:
    write_video(tmp_path / "cam.avi", [picture(0, t) for t in range(5)], fps=100)
    assert [place for place, _ in _numbers(tmp_path, 100)] == [0, 1, 2, 3, 4]
    raw = tmp_path / "cam.h264"
    write_video(raw, [picture(0, t) for t in range(5)])
    (camera,) = find_cameras([f"a={raw}"], 100)
    start = time.time_ns()
    assert [round((taken.capture_ns - start) / 1e7) for taken in camera.pictures(start)] == [0, 1, 2, 3, 4]


def test_files_that_repeat_begin_together_at_their_own_rate(tmp_path: Path) -> None:
    """Whatever rate is said of sources without times; a camera that stopped first waits for the others."""
    write_video(tmp_path / "long.mp4", [picture(0, t) for t in range(5)], fps=50)
    write_video(tmp_path / "short.mkv", [picture(0, t) for t in range(4)], fps=50)
    for camera in find_cameras([str(tmp_path)], 30, repeats=True):
        start, count = time.time_ns(), 5 if camera.name == "long" else 4
        taken = itertools.islice(camera.pictures(start), count + 2)
        places = [round((one.capture_ns - start) / 20_000_000) for one in taken]
        assert places == [*range(count), 5, 6]
