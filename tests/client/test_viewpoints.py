"""Cameras to look from."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from streamlod.client.viewpoints import camera_named, focus_point, orbit, read_poses
from streamlod.core.camera import look_at, pinhole
from streamlod.core.errors import InputError
from tests.client.clips import plain_scene

HEADER = plain_scene((1,)).header
POSE = np.eye(4).tolist()


def test_cameras_are_found_by_name() -> None:
    assert camera_named(HEADER, "cam01").name == "cam01"
    with pytest.raises(InputError, match="cam00, cam01"):
        camera_named(HEADER, "cam99")


def test_focus_is_where_the_axes_meet() -> None:
    target = np.array([0.3, -0.2, 5.0])
    centres = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0.5]])
    forwards = np.stack([look_at(c, target, np.array([0.0, -1, 0]))[2, :3] for c in centres])
    np.testing.assert_allclose(focus_point(centres, forwards, 9.0), target, atol=1e-9)
    parallel = np.repeat([[0.0, 0, 1]], 3, axis=0)
    np.testing.assert_allclose(focus_point(centres, parallel, 9.0), centres.mean(axis=0) + np.array([0, 0, 9]))
    assert focus_point(centres, -forwards, 2.0)[2] < 0


def test_orbit_circles_and_keeps_looking_at_the_focus() -> None:
    target, up = np.array([0.0, 0, 4]), np.array([0.0, -1, 0])
    rig = [
        pinhole(str(x), (100, 100), (50, 40), (100, 80), look_at(np.array([x, 0.0, 0]), target, up)) for x in range(5)
    ]
    path = orbit(replace(HEADER, cameras=tuple(rig)), 20)
    cameras = [path(number) for number in range(20)]
    for camera in cameras:
        ahead = camera.world_to_camera @ np.append(target, 1)
        np.testing.assert_allclose(ahead[:2], 0, atol=1e-9)
        assert camera.world_to_camera[1, 1] > 0.8  # y stays down: the horizon is level
        assert 0 < camera.centre[0] < 4
        assert (camera.width, camera.height) == (100, 80)
    steps = np.linalg.norm(np.diff([camera.centre for camera in cameras], axis=0), axis=1)
    assert steps.min() > 0
    np.testing.assert_allclose(path(20).centre, path(0).centre, atol=1e-9)


def test_orbit_of_a_single_camera_still_moves() -> None:
    path = orbit(replace(HEADER, cameras=HEADER.cameras[:1]), 4)
    assert np.linalg.norm(path(0).centre - path(2).centre) > 0.01
    with pytest.raises(InputError, match="no cameras"):
        orbit(replace(HEADER, cameras=()))
    for pictures in (0, -3):
        with pytest.raises(InputError, match=f"a turn needs a picture or more, not {pictures}"):
            orbit(HEADER, pictures)


def write(tmp_path: Path, value: Any) -> Path:
    path = tmp_path / "pose.json"
    path.write_text(value if isinstance(value, str) else json.dumps(value))
    return path


def test_poses_take_the_rest_from_the_rig(tmp_path: Path) -> None:
    path = read_poses(write(tmp_path, [{"world_to_camera": POSE}, {"world_to_camera": POSE[:3], "width": 240}]), HEADER)
    np.testing.assert_array_equal(path(0).intrinsics, HEADER.cameras[0].intrinsics)
    assert (path(1).width, path(7).width) == (240, 240)
    assert path(1).intrinsics[0, 0] == HEADER.cameras[0].intrinsics[0, 0] / 2
    own = {"world_to_camera": POSE, "width": 64, "height": 48, "focal": [50, 51], "principal": [1, 2]}
    camera = read_poses(write(tmp_path, own), replace(HEADER, cameras=()))(0)
    np.testing.assert_array_equal(camera.intrinsics, [[50, 0, 1], [0, 51, 2], [0, 0, 1]])


def test_a_byte_order_mark_before_poses_is_passed_over(tmp_path: Path) -> None:
    path = write(tmp_path, "\ufeff" + json.dumps({"world_to_camera": POSE}))
    np.testing.assert_array_equal(read_poses(path, HEADER)(0).world_to_camera, POSE)


@pytest.mark.parametrize(
    ("value", "fault"),
    [
        ("nonsense", "not JSON"),
        ("[" * 10_000, "not JSON"),
        ([], "no pose"),
        ([3], "no world_to_camera"),
        ({"world_to_camera": [[1, 2], [3, 4]]}, "3x4 or 4x4"),
        ({"world_to_camera": [["a"] * 4] * 4}, "pose 0"),
        ({"world_to_camera": [[2.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}, "rotation"),
        ('{"world_to_camera": [[NaN,0,0,0],[0,1,0,0],[0,0,1,0]]}', "not finite"),
        ({"world_to_camera": POSE, "width": 10**9}, "picture size"),
        ({"world_to_camera": POSE, "focal": [-1, 5]}, "focal"),
        ({"world_to_camera": POSE, "focal": [1, 2, 3]}, "pose 0"),
    ],
)
def test_pose_files_that_are_refused(tmp_path: Path, value: Any, fault: str) -> None:
    path = write(tmp_path, value)
    with pytest.raises(InputError, match=fault) as caught:
        read_poses(path, HEADER)
    assert str(path) in str(caught.value)


def test_a_scene_without_cameras_needs_whole_poses(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="width, height and focal"):
        read_poses(write(tmp_path, {"world_to_camera": POSE}), replace(HEADER, cameras=()))
    with pytest.raises(InputError, match="cannot be read"):
        read_poses(tmp_path / "absent.json", HEADER)
