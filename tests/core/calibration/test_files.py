"""Files of a calibration are read by the product as they were meant."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from streamlod.core.calibration.adjustment.observations import Observations
from streamlod.core.calibration.files import RIG, check_folder, write_calibration
from streamlod.core.calibration.solve import Calibration
from streamlod.core.calibration.walk import open_walk
from streamlod.core.camera import look_at
from streamlod.core.data import open_dataset
from streamlod.core.data.lens import opencv_camera
from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.definition import read_definition
from tests.core.data.writers import write_video

UP = np.array([0.0, 0, 1])
BLINK = 6  # picture in which everything is white


def calibration(names: list[str], offsets: list[float], size: tuple[int, int]) -> Calibration:
    cameras = []
    for number, name in enumerate(names):
        matrix = np.array([[60.0, 0, size[0] / 2 + number], [0, 61, size[1] / 2], [0, 0, 1]])
        pose = look_at(np.array([3.0, number, 1]), np.zeros(3), UP)
        cameras.append(opencv_camera(name, matrix, pose, size, np.array([-0.1, 0.02, 0.001, -0.002, 0.003])))
    count, none = len(names), np.zeros(len(names), np.int64)
    seen = Observations(np.arange(count), none, np.zeros((count, 3)), *np.zeros((5, count, 2)), *np.zeros((2, count)))
    offset, periods = np.array(offsets), np.full(count, 0.1)
    errors, uneven, places = np.zeros((count, 2)), np.zeros(count), np.zeros((0, 3))
    read = misses = np.zeros((count, 2))
    clocks = offset, read, periods
    sound = np.full(count, np.nan), *np.zeros((2, count), np.bool_)
    return Calibration(tuple(cameras), 0, *clocks, errors, uneven, *sound, True, np.zeros(0), places, seen, misses)


def blinking(first: int, size: tuple[int, int]) -> list[np.ndarray]:
    """Pictures that grow brighter, of which one is white."""
    pictures = [np.full((size[1], size[0], 3), 10 + 5 * number, np.uint8) for number in range(20)]
    pictures[first] = np.full_like(pictures[first], 255)
    return pictures


def test_train_and_serve_read_cameras_as_they_were_found(tmp_path: Path) -> None:
    size, names = (96, 64), ["phone b", "phone_a"]
    for name in names:
        write_video(tmp_path / f"{name}.mp4", blinking(BLINK, size), fps=10)
    found = calibration(names, [0.0, 0.0], size)
    files = write_calibration(found, open_walk(tmp_path), tmp_path)
    assert [file.name for file in files] == ["transforms.json", RIG]
    read = {camera.name: camera for camera in open_dataset(tmp_path).recording.cameras}
    live = read_definition(tmp_path / RIG).cameras
    for camera, other in zip(found.cameras, live, strict=True):
        for each in (read[camera.name], other):
            np.testing.assert_allclose(each.world_to_camera, camera.world_to_camera, atol=1e-12)
            np.testing.assert_allclose(each.intrinsics, camera.intrinsics)
            np.testing.assert_allclose(each.distortion, camera.distortion)


def test_time_offsets_pair_what_was_filmed_at_one_time(tmp_path: Path) -> None:
    size, videos, out = (96, 64), tmp_path / "walk", tmp_path / "rig"
    videos.mkdir()
    write_video(videos / "a.mp4", blinking(BLINK, size), fps=10)
    write_video(videos / "b.mp4", blinking(BLINK - 3, size), fps=10)  # b began 0.3 s later
    check_folder(out, overwrite=False)
    write_calibration(calibration(["a", "b"], [0.0, 0.3], size), open_walk(videos), out)
    bright = [frame.images.mean(axis=(1, 2, 3)) > 240 for frame in open_dataset(out).frames()]
    assert [tuple(both) for both in bright if both.any()] == [(True, True)]


def test_a_recording_of_caliscope_stays_one(tmp_path: Path) -> None:
    size, rows = (96, 64), ["sync_index,cam_id,frame_time"]
    for number in (3, 11):
        write_video(tmp_path / f"cam_{number}.mp4", blinking(BLINK, size), fps=10)
        rows += [f"{index},{number},{index / 10 + number / 1000}" for index in range(20)]
    (tmp_path / "timestamps.csv").write_text("\n".join(rows))
    walk = open_walk(tmp_path)
    assert [each.times[0] for each in walk] == [0.003, 0.011]
    found = calibration(["cam_3", "cam_11"], [0.0, 0.0], size)
    write_calibration(found, walk, tmp_path)
    assert set(tomllib.loads((tmp_path / "camera_array.toml").read_text())["cameras"]) == {"3", "11"}
    read = open_dataset(tmp_path)
    assert read.layout == "caliscope"
    np.testing.assert_allclose(read.recording.cameras[1].intrinsics, found.cameras[1].intrinsics)
    np.testing.assert_allclose(read.recording.cameras[1].world_to_camera, found.cameras[1].world_to_camera)


@pytest.mark.parametrize(("offset", "later"), [(0.0, 0), (0.13, 1), (-0.08, -1), (-0.22, -2)])
def test_offsets_pair_what_a_table_of_times_pairs_otherwise(tmp_path: Path, offset: float, later: int) -> None:
    size, rows = (96, 64), ["sync_index,cam_id,frame_time"]
    for number in (3, 11, 12):
        write_video(tmp_path / f"cam_{number}.mp4", blinking(BLINK, size), fps=10)
        rows += [f"{index},{number},{index / 10}" for index in range(20)]
    (tmp_path / "timestamps.csv").write_text("\n".join(rows))
    names = ["cam_3", "cam_11", "cam_12"]
    write_calibration(calibration(names, [0.0, offset, 0.01], size), open_walk(tmp_path), tmp_path)
    frames = list(open_dataset(tmp_path).frames())
    assert len(frames) == 20 - abs(later)
    bright = np.array([[image.mean() > 250 for image in frame.images] for frame in frames])
    first, moved, third = (int(column.argmax()) for column in bright.T)
    assert first == third == BLINK - max(0, later)
    assert moved - first == later
    np.testing.assert_allclose(np.diff([frame.time_ns for frame in frames]), 1e8, atol=1e3)


def test_times_that_do_not_increase_are_refused_where_offsets_move_them(tmp_path: Path) -> None:
    size, rows = (96, 64), ["sync_index,cam_id,frame_time"]
    for number in (3, 11):
        write_video(tmp_path / f"cam_{number}.mp4", blinking(BLINK, size), fps=10)
        rows += [f"{index},{number},{(index - 9 * (index == 12 and number == 11)) / 10}" for index in range(20)]
    (tmp_path / "timestamps.csv").write_text(
        "\n".join([rows[0], *(f"{i},{c},{i}" for c in (3, 11) for i in range(20))])
    )
    write_calibration(calibration(["cam_3", "cam_11"], [0.0, 0.13], size), open_walk(tmp_path), tmp_path)
    (tmp_path / "timestamps.csv").write_text("\n".join(rows))
    with pytest.raises(InputError, match="its times do not increase with sync_index"):
        open_dataset(tmp_path)


def test_an_earlier_calibration_is_not_replaced_unasked(tmp_path: Path) -> None:
    (tmp_path / "transforms.json").write_text("{}")
    with pytest.raises(InputError, match=r"transforms\.json: is there already"):
        check_folder(tmp_path, overwrite=False)
    check_folder(tmp_path, overwrite=True)


def test_offsets_that_no_video_has_are_refused(tmp_path: Path) -> None:
    size = (96, 64)
    for name in ("a", "b"):
        write_video(tmp_path / f"{name}.mp4", blinking(BLINK, size), fps=10)
    write_calibration(calibration(["a", "b"], [0.0, 1e9], size), open_walk(tmp_path), tmp_path)
    assert json.loads((tmp_path / "transforms.json").read_text())["frames"][1]["time_offset"] == 1e9
    with pytest.raises(InputError, match="time_offset is beyond"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("content", ["", "sync_index,cam_id\n1,2", "sync_index,cam_id,frame_time\n1,0,nan\n2,0,1"])
def test_damaged_tables_of_times_are_refused(tmp_path: Path, content: str) -> None:
    for name in ("cam_0", "cam_1"):
        write_video(tmp_path / f"{name}.mp4", blinking(BLINK, (96, 64)), fps=10)
    (tmp_path / "timestamps.csv").write_text(content)
    with pytest.raises(InputError, match=r"timestamps\.csv"):
        open_walk(tmp_path)
