"""The caliscope layout, written here and real."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera
from streamlod.core.data import open_dataset
from streamlod.core.data.lens import undistort
from streamlod.core.errors import InputError
from tests.core.data.writers import read_back, rig, write_caliscope

PRESENT = [[True, True], [True, True], [True, False], [False, True], [True, True]]


def _cameras() -> tuple[Camera, ...]:
    bent = np.array([0.02, -0.01, 0.001, 0.002, 0.003])
    return tuple(replace(camera, distortion=bent) for camera in rig(["cam_0", "cam_1"]))


def test_cameras_times_and_pairs(tmp_path: Path) -> None:
    write_caliscope(tmp_path, _cameras(), PRESENT)
    dataset = open_dataset(tmp_path)
    assert (dataset.layout, dataset.names, dataset.frame_count) == ("caliscope", ("cam_0", "cam_1"), 5)
    assert dataset.fps == pytest.approx(10, rel=0.02)
    for found, wanted in zip(dataset.recording.cameras, _cameras(), strict=True):
        np.testing.assert_allclose(found.intrinsics, wanted.intrinsics)
        np.testing.assert_allclose(found.world_to_camera, wanted.world_to_camera, atol=1e-9)
        np.testing.assert_array_equal(found.distortion, wanted.distortion)
    frames = list(dataset.frames())
    assert [frame.present.tolist() for frame in frames] == PRESENT
    # the mean over the cameras that saw the instant, whose clocks differ by 1 ms
    assert [frame.time_ns for frame in frames] == pytest.approx([0, 100e6, 199.5e6, 300.5e6, 400e6], abs=10)
    for frame in frames:
        for camera in np.flatnonzero(frame.present):
            assert read_back(frame.images[camera]) == (camera, frame.index)
    later = list(dataset.frames(3))
    assert [read_back(frame.images[1]) for frame in later] == [(1, 3), (1, 4)]


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("timestamps.csv", "7,0,25.0\n", "", r"has 3 times of cam_0\.mp4, which holds 4 pictures"),
        ("timestamps.csv", "7,0,25.0", "7,0,soon", r"timestamps\.csv: needs the columns"),
        ("timestamps.csv", "sync_index", "index", r"timestamps\.csv: needs the columns"),
        ("timestamps.csv", "25.", "nan ", r"timestamps\.csv: "),
        ("camera_array.toml", "[cameras.0]", "[cameras.0", r"camera_array\.toml: is not valid TOML"),
        ("camera_array.toml", "cameras", "cams", r"needs a table \[cameras\.N\]"),
        ("camera_array.toml", "distortions", "d", "distortions must be numbers of shape 5"),
        ("camera_array.toml", "[96, 64]", "[0, 64]", "camera cam_0: picture size is not possible"),
        ("camera_array.toml", "[96, 64]", "[64, 64]", "does not fit the calibration's 64x64"),
    ],
)
def test_faults_are_named(tmp_path: Path, file: str, old: str, new: str, message: str) -> None:
    write_caliscope(tmp_path, _cameras(), PRESENT)
    path = tmp_path / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=message):
        open_dataset(tmp_path)


def test_ignored_cameras_are_left_out(tmp_path: Path) -> None:
    write_caliscope(tmp_path, _cameras(), [[True, True]] * 2)
    path = tmp_path / "camera_array.toml"
    path.write_text(path.read_text().replace("ignore = false", "ignore = true", 1))
    assert open_dataset(tmp_path).names == ("cam_1",)


def _corners(folder: Path) -> dict[tuple[int, int], dict[int, Float64]]:
    """Board corners of raw pictures: (instant, corner) -> camera -> pixel, the first pixel's centre at 0.5."""
    corners: dict[tuple[int, int], dict[int, Float64]] = {}
    with (folder / "xy_CHARUCO.csv").open() as file:
        for row in csv.DictReader(file):
            key = (int(row["sync_index"]) - 35, int(row["keypoint_id"]))
            pixel = np.array([float(row["img_loc_x"]), float(row["img_loc_y"])]) + 0.5
            corners.setdefault(key, {})[int(row["cam_id"])] = pixel
    return corners


def test_real_recording_is_undistorted_and_paired(real_data: Path) -> None:
    """Corners of the board that moves: they lie where the pinholes say, and meet in space across cameras."""
    dataset = open_dataset(real_data / "caliscope_4cam")
    assert (len(dataset.cameras), dataset.frame_count) == (4, 57)
    assert dataset.fps == pytest.approx(6, rel=0.05)
    corners = _corners(real_data / "caliscope_4cam")
    moved, residuals = [], []
    for frame in dataset.frames(20, 23):
        found: dict[int, list[tuple[Camera, Float64]]] = {}
        for (instant, corner), pixels in corners.items():
            for index, pixel in pixels.items() if instant == frame.index else ():
                raw, camera = dataset.recording.cameras[index], dataset.cameras[index]
                ray = undistort((pixel - raw.intrinsics[:2, 2])[None] / raw.intrinsics[[0, 1], [0, 1]], raw.distortion)
                predicted = ray[0] * camera.intrinsics[[0, 1], [0, 1]] + camera.intrinsics[:2, 2]
                if not ((predicted > 10) & (predicted < [1270, 710])).all():
                    continue
                grey = cv2.cvtColor(frame.images[index], cv2.COLOR_RGB2GRAY)
                start = (predicted - 0.5).astype(np.float32).reshape(1, 1, 2)
                stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01)
                refined = cv2.cornerSubPix(grey, start.copy(), (4, 4), (-1, -1), stop).reshape(2) + 0.5
                moved.append(np.linalg.norm(refined - predicted))
                found.setdefault(corner, []).append((camera, predicted))
        residuals += [residual for views in found.values() if len(views) > 1 for residual in _triangulated(views)]
    assert len(moved) > 60
    assert np.median(moved) < 0.6
    assert len(residuals) > 40
    assert np.median(residuals) < 2.0


def _triangulated(views: list[tuple[Camera, Float64]]) -> list[float]:
    """Distances in pixels between the views' corners and the projections of the point that fits them best."""
    rows = []
    for camera, (u, v) in views:
        matrix = camera.intrinsics @ camera.world_to_camera[:3]
        rows += [u * matrix[2] - matrix[0], v * matrix[2] - matrix[1]]
    point = np.linalg.svd(np.array(rows))[2][-1]
    residuals = []
    for camera, pixel in views:
        projected = camera.intrinsics @ camera.world_to_camera[:3] @ point
        residuals.append(float(np.linalg.norm(projected[:2] / projected[2] - pixel)))
    return residuals


def test_a_camera_that_was_not_placed_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_caliscope(tmp_path, _cameras(), PRESENT)
    file = tmp_path / "camera_array.toml"
    text = file.read_text()
    lines = [line for line in text.split("[cameras.1]")[1].splitlines() if not line.startswith(("rotation", "transl"))]
    file.write_bytes(b"\xef\xbb\xbf" + (text.split("[cameras.1]")[0] + "[cameras.1]" + "\n".join(lines)).encode())
    assert open_dataset(tmp_path).names == ("cam_0",)
    assert "left out, as the calibration did not place them: cam_1" in caplog.text


def test_faults_name_the_file_once(tmp_path: Path) -> None:
    write_caliscope(tmp_path, _cameras(), PRESENT)
    file = tmp_path / "camera_array.toml"
    file.write_text(file.read_text().replace("distortions", "d"))
    with pytest.raises(InputError) as caught:
        open_dataset(tmp_path)
    assert str(caught.value).count("camera_array.toml") == 1
