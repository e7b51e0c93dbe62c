"""transforms.json of nerfstudio and instant-ngp."""

from __future__ import annotations

import json
import logging
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from streamlod.core.data import open_dataset
from streamlod.core.data.transforms import opengl_pose
from streamlod.core.errors import InputError
from tests.core.data.writers import (
    picture,
    read_back,
    rig,
    write_picture,
    write_transforms,
    write_video,
    write_video_clip,
)

NAMES = ("cam00", "cam02", "cam10")
FILES = tuple(f"images/{name}.png" for name in NAMES)


def _write(folder: Path, **extra: object) -> None:
    write_transforms(folder, FILES[::-1], rig(NAMES)[::-1], **extra)
    for index, file in enumerate(FILES):
        write_picture(folder / file, picture(index, 0))


def test_data_of_nerf_train_their_training_cameras(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As Blender's exporters write it: names without suffix, the angle of view at the top, other cameras beside."""
    for split, cameras in (("train", rig(NAMES)), ("test", rig(("cam00",))), ("val", rig(("cam00",)))):
        files = [f"./{split}/{camera.name}" for camera in cameras]
        write_transforms(tmp_path, files, cameras)
        value = json.loads((tmp_path / "transforms.json").read_text())
        frames = [{key: frame[key] for key in ("file_path", "transform_matrix")} for frame in value["frames"]]
        angle = 2 * math.atan(48 / 80)
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": angle, "frames": frames}))
        (tmp_path / "transforms.json").unlink()
        for index, camera in enumerate(cameras):
            write_picture(tmp_path / split / f"{camera.name}.png", picture(index, 0))
    with caplog.at_level(logging.INFO):
        opened = open_dataset(tmp_path)
    assert opened.names == NAMES
    assert opened.cameras[1].intrinsics[0, 0] == pytest.approx(80)
    np.testing.assert_allclose(opened.cameras[1].world_to_camera, rig(NAMES)[1].world_to_camera, atol=1e-12)
    assert [read_back(image) for image in next(iter(opened.frames())).images] == [(0, 0), (1, 0), (2, 0)]
    assert "its cameras are used, not those of transforms_test.json, transforms_val.json" in caplog.text
    assert open_dataset(tmp_path / "transforms_train.json").names == NAMES
    _write(tmp_path)
    (tmp_path / "train" / "cam00.png").unlink()
    assert open_dataset(tmp_path).skipped == ()  # transforms.json comes first


def test_videos_come_before_what_was_converted_from_them(tmp_path: Path) -> None:
    write_video_clip(tmp_path, NAMES, frames=2)
    write_transforms(tmp_path, ["a.png"], rig(NAMES[:1]))
    (tmp_path / "transforms.json").rename(tmp_path / "transforms_train.json")
    assert open_dataset(tmp_path).layout == "n3dv"


def test_an_upright_camera_among_lying_ones_shows_a_point_where_it_is(tmp_path: Path) -> None:
    """A red dot at the origin, which all cameras look at from their own places, off the middle of the picture."""
    lying = rig(NAMES)
    tall = replace(lying[1], width=64, height=96, intrinsics=np.array([[80.0, 0, 20], [0, 90, 70], [0, 0, 1]]))
    cameras = (lying[0], tall, lying[2])
    write_transforms(tmp_path, FILES, cameras)
    for file, camera in zip(FILES, cameras, strict=True):
        image = np.zeros((camera.height, camera.width, 3), np.uint8)
        column, row = (int(x) for x in camera.intrinsics[:2, 2])
        image[row - 1 : row + 1, column - 1 : column + 1, 0] = 255
        write_picture(tmp_path / file, image)
    opened = open_dataset(tmp_path)
    frame = next(iter(opened.frames()))
    for camera, image in zip(opened.cameras, frame.images, strict=True):
        x, y, z = camera.intrinsics @ camera.world_to_camera[:3, 3]
        rows, columns = np.nonzero(image[..., 0])
        np.testing.assert_allclose([columns.mean() + 0.5, rows.mean() + 0.5], [x / z, y / z], atol=1e-6)
    assert [(camera.width, camera.height) for camera in opened.upright] == [(96, 64), (64, 96), (96, 64)]
    np.testing.assert_allclose(opened.upright[1].intrinsics, tall.intrinsics)
    np.testing.assert_allclose(opened.upright[1].world_to_camera, tall.world_to_camera, atol=1e-12)


def _edit(folder: Path, **changes: object) -> None:
    """Change the settings of the first frame listed, which is cam10; None removes one."""
    path = folder / "transforms.json"
    value: dict[str, Any] = json.loads(path.read_text())
    for key, change in changes.items():
        value["frames"][0].pop(key, None)
        if change is not None:
            value["frames"][0][key] = change
    path.write_text(json.dumps(value))


def test_cameras_and_pictures(tmp_path: Path) -> None:
    _write(tmp_path)
    for path in (tmp_path, tmp_path / "transforms.json"):
        dataset = open_dataset(path)
        assert (dataset.layout, dataset.names, dataset.frame_count) == ("transforms", NAMES, 1)
    for found, wanted in zip(dataset.cameras, rig(NAMES), strict=True):
        np.testing.assert_allclose(found.intrinsics, wanted.intrinsics)
        np.testing.assert_allclose(found.world_to_camera, wanted.world_to_camera, atol=1e-12)
    (frame,) = dataset.frames()
    assert [read_back(image) for image in frame.images] == [(0, 0), (1, 0), (2, 0)]


def test_opengl_axes_by_hand() -> None:
    matrix = np.eye(4)
    matrix[:3, 3] = [0, 0, 5]  # stands at z = 5 and looks along -z with +y up
    pose = opengl_pose(matrix)
    np.testing.assert_allclose(pose @ [1, 0, 0, 1], [1, 0, 5, 1])
    np.testing.assert_allclose(pose @ [0, 1, 0, 1], [0, -1, 5, 1])


def test_missing_files_are_skipped_counted_and_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    _write(tmp_path)
    (tmp_path / FILES[1]).unlink()
    with caplog.at_level(logging.WARNING):
        dataset = open_dataset(tmp_path)
    assert (dataset.names, dataset.skipped) == (("cam00", "cam10"), (FILES[1],))
    assert "1 of 3 listed files are missing: images/cam02.png" in caplog.text


def test_angle_of_view_and_names_without_suffix(tmp_path: Path) -> None:
    angle = 2 * math.atan(96 / 2 / 80)
    matrix = np.eye(4).tolist()
    frames = [{"file_path": "./train/r_0", "transform_matrix": matrix}]
    (tmp_path / "transforms.json").write_text(json.dumps({"camera_angle_x": angle, "frames": frames}))
    write_picture(tmp_path / "train" / "r_0.png", picture(0, 0))
    (camera,) = open_dataset(tmp_path).cameras
    assert camera.name == "r_0"
    np.testing.assert_allclose(camera.intrinsics, [[80, 0, 48], [0, 80, 32], [0, 0, 1]])


def test_distortion_and_reduced_pictures(tmp_path: Path) -> None:
    large = tuple(replace(c, distortion=np.array([0.01, 0, 0, 0.001, 0])) for c in rig(NAMES, (192, 128)))
    write_transforms(tmp_path, FILES, large, camera_model="OPENCV")
    for index, file in enumerate(FILES):
        write_picture(tmp_path / file, picture(index, 0))
    for raw, wanted in zip(open_dataset(tmp_path).recording.cameras, large, strict=True):
        np.testing.assert_allclose(raw.intrinsics[:2], wanted.intrinsics[:2] / 2)
        np.testing.assert_array_equal(raw.distortion, wanted.distortion)


def test_videos(tmp_path: Path) -> None:
    for index, name in enumerate(NAMES):
        write_video(tmp_path / f"{name}.mp4", [picture(index, t) for t in range(4)])
    write_transforms(tmp_path, [f"{name}.mp4" for name in NAMES], rig(NAMES))
    dataset = open_dataset(tmp_path)
    assert dataset.frame_count == 4
    assert [read_back(frame.images[1]) for frame in dataset.frames(1, 3)] == [(1, 1), (1, 2)]


def test_matrices_of_three_rows_and_absolute_paths_into_the_folder(tmp_path: Path) -> None:
    _write(tmp_path)
    whole = open_dataset(tmp_path)
    pose = json.loads((tmp_path / "transforms.json").read_text())["frames"][0]["transform_matrix"]
    _edit(tmp_path, transform_matrix=pose[:3], file_path=str(tmp_path.absolute() / FILES[2]))
    found = open_dataset(tmp_path)
    assert found.names == whole.names
    np.testing.assert_array_equal(found.cameras[2].world_to_camera, whole.cameras[2].world_to_camera)
    assert read_back(next(found.frames()).images[2]) == (2, 0)


def test_ways_out_of_the_folder_and_back_are_followed(tmp_path: Path) -> None:
    (tmp_path / "shoot").mkdir()
    _write(tmp_path / "shoot")
    whole = open_dataset(tmp_path / "shoot")
    _edit(tmp_path / "shoot", file_path=f"../shoot/images/../{FILES[2]}")
    assert open_dataset(tmp_path / "shoot").names == whole.names


def test_masks_are_not_used_which_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    _write(tmp_path)
    _edit(tmp_path, mask_path="masks/cam10.png")
    with caplog.at_level(logging.WARNING):
        open_dataset(tmp_path)
    assert "masks (mask_path) are not used" in caplog.text


def test_pictures_of_other_kinds_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    _write(tmp_path)
    (tmp_path / FILES[2]).rename((tmp_path / FILES[2]).with_suffix(".webp"))
    with caplog.at_level(logging.WARNING):
        assert open_dataset(tmp_path).names == NAMES[:2]
    assert "only PNG and JPEG are read; convert cam10.webp" in caplog.text


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fl_x": 0}, "camera cam10: focal length must be positive"),
        ({"fl_x": "wide"}, "fl_x must be a number, not 'wide'"),
        ({"fl_x": None, "fl_y": None}, "its focal length is missing"),
        ({"w": math.nan}, "picture size nanx64 is not possible"),
        ({"w": 300}, "does not fit the calibration's 300x64"),
        ({"transform_matrix": [[1, 2], [3, 4]]}, "transform_matrix of cam10 must be numbers of shape 4x4"),
        ({"transform_matrix": None}, "transform_matrix of cam10 must be"),
        ({"transform_matrix": (2 * np.eye(4)).tolist()}, "camera cam10: its pose does not hold a rotation"),
        ({"transform_matrix": np.diag([1, 1, -1, 1]).tolist()}, "camera cam10: its pose is mirrored"),
        ({"fl_x": 0.83, "fl_y": 0.83}, "its focal length is 0.83 for pictures of 96x64; give it in pixels"),
        ({"cx": 4800}, "its principal point is 4800, 32 for pictures of 96x64; give it in pixels"),
        ({"transform_matrix": (np.nan * np.eye(4)).tolist()}, "camera cam10: its pose holds numbers that are not"),
        ({"camera_model": "OPENCV_FISHEYE"}, "lens model OPENCV_FISHEYE is not supported"),
        ({"is_fisheye": True}, r"a lens of another kind \(is_fisheye\) is not supported"),
        ({"latlong": True}, r"a lens of another kind \(latlong\) is not supported"),
        ({"ftheta_p0": 0.1}, r"a lens of another kind \(ftheta_p0\) is not supported"),
        ({"transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 5, 1]]}, "is it transposed"),
        ({"k4": 0.1}, "the coefficient k4 is not supported"),
        ({"camera_model": "FULL_OPENCV", "k6": 0.1}, "the coefficient k6 is not supported"),
        ({"s1": 0.1}, "the coefficient s1 is not supported"),
        ({"file_path": r"..\other.png"}, "leads out of the folder"),
        ({"file_path": "../other.png"}, "leads out of the folder"),
        ({"transform_matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}, "transform_matrix of cam10 must be"),
        ({"file_path": "/etc/passwd"}, "leads out of the folder"),
        ({"file_path": 7}, "each frame needs a 'file_path'"),
        ({"file_path": FILES[0]}, "holds two cameras called"),
        ({"time": 0.5}, "lists several instants"),
    ],
)
def test_faults_are_named(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    _write(tmp_path)
    _edit(tmp_path, **changes)
    with pytest.raises(InputError, match=message):
        open_dataset(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not valid JSON"),
        ("[]", "must hold a JSON object"),
        ("{}", "'frames' must be a list"),
        ('{"frames": []}', "'frames' lists no pictures"),
        ("[" * 100_000, "is not valid JSON"),
    ],
)
def test_files_that_are_not_transforms(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(InputError, match=rf"transforms\.json: {message}"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("name", ["images/cam10.jpg", "images/cam10", "images/CAM10.PNG", "images\\\\cam10.png"])
def test_names_written_otherwise_lead_to_their_files(tmp_path: Path, name: str) -> None:
    _write(tmp_path)
    _edit(tmp_path, file_path=name)
    dataset = open_dataset(tmp_path)
    assert (dataset.names, dataset.skipped) == (NAMES, ())


def test_a_name_written_otherwise_never_serves_two_cameras(tmp_path: Path) -> None:
    _write(tmp_path)
    _edit(tmp_path, file_path="images/CAM00.png")
    assert open_dataset(tmp_path).names == ("cam00", "cam02")


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    _write(tmp_path)
    file = tmp_path / "transforms.json"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert open_dataset(tmp_path).names == NAMES
    file.write_text(file.read_text("utf-8-sig"), "utf-16")
    with pytest.raises(InputError, match=r"transforms\.json: is UTF-16 text; save it as UTF-8"):
        open_dataset(tmp_path)
