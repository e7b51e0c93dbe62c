"""Cameras: conventions, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.errors import InputError

coordinates = st.floats(-10, 10)
points = st.tuples(coordinates, coordinates, coordinates).map(lambda xyz: np.array(xyz, np.float64))


def _camera(**changes: Any) -> Camera:
    fields = {
        "name": "cam00",
        "intrinsics": np.array([[100, 0, 48], [0, 90, 32], [0, 0, 1.0]]),
        "world_to_camera": np.eye(4),
        "width": 96,
        "height": 64,
        "distortion": np.zeros(5),
    }
    return Camera(**{**fields, **changes})


def _project(camera: Camera, point: np.ndarray) -> np.ndarray:
    pixel = camera.intrinsics @ (camera.world_to_camera @ np.append(point, 1))[:3]
    return np.asarray(pixel[:2] / pixel[2])


@settings(deadline=None)
@given(eye=points, target=points)
def test_look_at_puts_the_target_in_the_middle_and_up_on_top(eye: np.ndarray, target: np.ndarray) -> None:
    up = np.array([0.0, 1, 0])
    if np.linalg.norm(np.cross(target - eye, up)) < 1e-2:
        return
    pose = look_at(eye, target, up)
    camera = pinhole("c", (100, 100), (48, 32), (96, 64), pose)
    np.testing.assert_allclose(camera.centre, eye, atol=1e-8)
    np.testing.assert_allclose(_project(camera, target), [48, 32], atol=1e-6)
    assert (pose @ np.append(target, 1))[2] == pytest.approx(np.linalg.norm(target - eye))
    assert _project(camera, target + 1e-3 * up)[1] < 32  # y points down in the picture


@pytest.mark.parametrize(("target", "up"), [([1.0, 2, 3], [0.0, 1, 0]), ([1.0, 9, 3], [0.0, 1, 0])])
def test_look_at_needs_a_direction(target: list[float], up: list[float]) -> None:
    with pytest.raises(ValueError, match="look_at needs"):
        look_at(np.array([1.0, 2, 3]), np.array(target), np.array(up))


@settings(deadline=None)
@given(width=st.integers(1, 500), height=st.integers(1, 500))
def test_scaling_keeps_where_points_lie_in_the_picture(width: int, height: int) -> None:
    camera = _camera()
    scaled = camera.scaled(width, height)
    point = np.array([0.3, -0.2, 2])
    np.testing.assert_allclose(
        _project(scaled, point) / [width, height], _project(camera, point) / [camera.width, camera.height]
    )
    np.testing.assert_allclose(scaled.scaled(96, 64).intrinsics, camera.intrinsics)


@settings(deadline=None)
@given(point=points)
def test_a_turned_camera_sees_what_its_turned_picture_shows(point: np.ndarray) -> None:
    camera = _camera(world_to_camera=look_at(np.array([1.0, 2, -40]), np.zeros(3), np.array([0.3, 1, 0])))
    turned = camera.turned()
    (u, v), seen = _project(camera, point), _project(turned, point)
    np.testing.assert_allclose(seen, [v, camera.width - u], atol=1e-9)
    assert (turned.width, turned.height) == (camera.height, camera.width)
    np.testing.assert_allclose(turned.centre, camera.centre, atol=1e-12)
    marked = np.zeros((camera.height, camera.width))
    row, column = 3, 7
    marked[row, column] = 1
    again = np.argwhere(np.rot90(marked))[0] + 0.5
    np.testing.assert_array_equal(again, [camera.width - (column + 0.5), row + 0.5])


def test_distortion_is_dropped_only_on_request() -> None:
    bent = _camera(distortion=np.array([0, 0, 0, 1e-3, 0]))
    assert bent.has_distortion
    assert not bent.undistorted().has_distortion
    assert not _camera().has_distortion


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"intrinsics": np.diag([0, 90, 1.0])}, "focal length must be positive"),
        ({"intrinsics": np.diag([100, -90, 1.0])}, "focal length must be positive"),
        ({"intrinsics": np.diag([np.nan, 90, 1.0])}, "its intrinsics holds numbers that are not finite"),
        ({"distortion": np.array([0, np.inf, 0, 0, 0])}, "its distortion holds"),
        ({"world_to_camera": np.full((4, 4), np.nan)}, "its pose holds numbers"),
        ({"world_to_camera": 1.01 * np.eye(4)}, "does not hold a rotation"),
        ({"world_to_camera": np.diag([1, 1, -1, 1.0])}, "its pose is mirrored"),
        ({"world_to_camera": np.zeros((4, 4))}, "does not hold a rotation"),
        ({"world_to_camera": 1e200 * np.eye(4)}, "its pose holds numbers beyond 1e\\+12"),
        ({"width": 0}, "picture size 0x64"),
        ({"width": 96 / 2}, "picture size 48.0x64 is not in whole pixels"),
    ],
)
def test_faults_name_the_camera(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=f"camera cam00: .*{message}"):
        _camera(**changes)


def test_shapes_and_types_are_checked() -> None:
    with pytest.raises(TypeError, match="intrinsics must be an array of float64"):
        _camera(intrinsics=np.eye(3, dtype=np.float32))
    with pytest.raises(ValueError, match="distortion must have shape 5, not 4"):
        _camera(distortion=np.zeros(4))
