"""Undistortion, against rays traced through OpenCV's own model."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from streamlod.core.arrays import Float64, UInt8
from streamlod.core.camera import Camera
from streamlod.core.data.lens import (
    distort,
    opencv_camera,
    opencv_matrix,
    scaled_size,
    undistort,
    undistorted_camera,
    undistortion,
    undistortions,
)
from streamlod.core.errors import InputError
from tests.core.data.writers import rig

BARREL = np.array([-0.33, 0.046, -0.004, 0.004, 0.067])
PINCUSHION = np.array([0.18, -0.05, 0.003, 0.002, 0.02])


def _camera(distortion: Float64) -> Camera:
    intrinsics = np.array([[200, 0, 118], [0, 204, 83], [0, 0, 1.0]])
    return replace(rig(["cam"], (240, 160))[0], intrinsics=intrinsics, distortion=distortion)


def _shade(rays: Float64) -> Float64:
    """A smooth picture as a function of direction, [N,2] to [N,3] in 0..255."""
    x, y = rays[:, 0], rays[:, 1]
    return 128 + 100 * np.stack([np.sin(5 * x) * np.cos(4 * y), np.sin(3 * x + 6 * y), np.cos(7 * x - 2 * y)], axis=1)


def _pixel_centres(camera: Camera) -> Float64:
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    return np.stack([u, v], axis=-1).reshape(-1, 2)


def _picture(camera: Camera) -> UInt8:
    """What `camera` sees of `_shade`; OpenCV inverts the distortion."""
    centres = _pixel_centres(camera)[:, None] - 0.5
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    name = "undistortPointsIter" if hasattr(cv2, "undistortPointsIter") else "undistortPoints"
    rays = getattr(cv2, name)(
        centres, opencv_matrix(camera), camera.distortion, R=None, P=None, criteria=criteria
    ).reshape(-1, 2)
    return np.round(_shade(rays)).astype(np.uint8).reshape(camera.height, camera.width, 3)


@pytest.mark.parametrize("turned", [False, True])
def test_points_of_a_picture_undone_by_the_wrong_lens_go_where_the_right_one_shows_them(turned: bool) -> None:
    first = _camera(np.zeros(5)) if not turned else replace(_camera(np.zeros(5)), width=160, height=240)
    wrong, right = undistortions([first, _camera(BARREL), _camera(PINCUSHION)], 1.6)[1:]
    assert wrong.is_turned == turned
    points = np.array([[20.0, 15.0], [50.0, 40.0], [70.0, 80.0]])
    raw = np.zeros((160, 240, 3), np.uint8)
    moved = wrong.as_by(right, points)
    assert np.abs(moved - points).max() > 2
    np.testing.assert_allclose(right.as_by(wrong, moved), points, atol=1e-5)
    v, u = np.mgrid[:160, :240]
    raw = np.stack([u, v, 0 * u], axis=-1).astype(np.uint8)  # each pixel tells where it lies
    told = [
        cv2.remap(plan(raw).astype(np.float32), np.float32(at - 0.5), None, cv2.INTER_LINEAR)[:, 0]
        for plan, at in ((wrong, points), (right, moved))
    ]
    np.testing.assert_allclose(told[0], told[1], atol=1.0)


@pytest.mark.parametrize("coefficients", [BARREL, PINCUSHION], ids=["barrel", "pincushion"])
@pytest.mark.parametrize("downscale", [1, 2, 2.5])
def test_undistorted_pictures_are_those_of_the_pinhole(coefficients: Float64, downscale: float) -> None:
    camera = _camera(coefficients)
    plan = undistortion(camera, scaled_size(camera.width, camera.height, downscale))
    undistorted = plan(_picture(camera))
    expected = _picture(plan.camera)
    assert not plan.camera.has_distortion
    assert undistorted.shape == (plan.camera.height, plan.camera.width, 3)
    difference = np.abs(undistorted.astype(int) - expected)
    assert difference.mean() < 0.5
    assert difference.max() <= 6  # no empty corner and no half-pixel shift, which would be up to 12


def test_half_a_pixel_of_shift_would_be_noticed() -> None:
    plan = undistortion(_camera(BARREL), (240, 160))
    intrinsics = plan.camera.intrinsics.copy()
    intrinsics[:2, 2] += 0.5
    shifted = np.abs(_picture(plan.camera).astype(int) - _picture(replace(plan.camera, intrinsics=intrinsics)))
    assert shifted.mean() > 0.8


@pytest.mark.parametrize("coefficients", [BARREL, PINCUSHION], ids=["barrel", "pincushion"])
def test_every_pixel_of_the_pinhole_was_seen_and_one_lies_on_the_border(coefficients: Float64) -> None:
    camera = _camera(coefficients)
    straight = undistorted_camera(camera)
    corners = np.array([[u, v] for u in np.linspace(0, 240, 49) for v in np.linspace(0, 160, 33)])
    rays = (corners - straight.intrinsics[:2, 2]) / straight.intrinsics[[0, 1], [0, 1]]
    seen = distort(rays, coefficients) * camera.intrinsics[[0, 1], [0, 1]] + camera.intrinsics[:2, 2]
    assert (seen >= -0.05).all()
    assert (seen <= np.array([240, 160]) + 0.05).all()
    assert min(seen.min(), (np.array([240, 160]) - seen).min()) < 0.5


def test_distort_is_opencvs_and_undistort_its_inverse() -> None:
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (200, 2))
    expected, _ = cv2.projectPoints(
        np.concatenate([points, np.ones((200, 1))], 1), np.zeros(3), np.zeros(3), np.eye(3), BARREL
    )
    np.testing.assert_allclose(distort(points, BARREL), expected.reshape(-1, 2), atol=1e-12)
    np.testing.assert_allclose(undistort(distort(points, BARREL), BARREL), points, atol=1e-6)


def test_points_beyond_the_lens_are_not_invented() -> None:
    fold = np.array([-0.3, 0, 0, 0, 0])  # x (1 - 0.3 x^2) never exceeds 0.7027
    assert np.isnan(undistort(np.array([[3.0, 0.0], [0.71, 0.0]]), fold)).all()
    np.testing.assert_allclose(undistort(np.array([[0.7, 0.0]]), fold), [[1, 0]], atol=1e-9)


def test_absurd_distortion_is_refused() -> None:
    with pytest.raises(InputError, match="camera cam: its distortion"):
        undistortion(_camera(np.array([-2.0, 0, 0, 0, 0])), (240, 160))


def test_pictures_of_one_shape_get_the_smallest_size() -> None:
    cameras = [_camera(BARREL), _camera(np.zeros(5)).scaled(480, 320), _camera(BARREL).scaled(121, 80)]
    plans = undistortions(cameras, 2)
    assert [(plan.lens.width, plan.lens.height) for plan in plans] == [(240, 160), (480, 320), (121, 80)]
    assert {(plan.camera.width, plan.camera.height) for plan in plans} == {(60, 40)}
    np.testing.assert_allclose(plans[1].camera.intrinsics[:2], _camera(BARREL).intrinsics[:2] / 4)


def test_upright_pictures_are_turned_to_lie_like_the_first() -> None:
    intrinsics = np.array([[200, 0, 83], [0, 204, 118], [0, 0, 1.0]])
    tall = replace(_camera(BARREL), width=160, height=240, intrinsics=intrinsics)
    wide, turned = undistortions([_camera(np.zeros(5)).scaled(480, 320), tall], 2)
    assert (turned.upright.width, turned.upright.height) == (80, 120)
    assert {(plan.camera.width, plan.camera.height) for plan in (wide, turned)} == {(120, 80)}, "the smaller one's size"
    difference = np.abs(turned(_picture(tall)).astype(int) - np.rot90(_picture(turned.upright)))
    assert difference.mean() < 0.5
    assert difference.max() <= 6
    np.testing.assert_array_equal(turned.camera.intrinsics, turned.upright.turned().intrinsics)
    assert not wide.is_turned
    first, other = undistortions([tall, _camera(BARREL)], 1)
    assert (first.camera.width, first.camera.height) == (other.camera.width, other.camera.height) == (160, 240)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"width": 160, "height": 160},
            "has pictures of 160x160, but cam of 240x160; crop them to one",
        ),
        ({"width": 240, "height": 150}, "crop them to one shape"),
        (
            {"intrinsics": np.diag([0.83, 0.85, 1])},
            "its focal length is 0.83 for .* 240x160; give it in pixels",
        ),
    ],
)
def test_pictures_that_do_not_belong_together_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        undistortions([_camera(np.zeros(5)), replace(_camera(np.zeros(5)), **change)], 1)


def test_opencv_camera_and_matrix_are_inverse() -> None:
    camera = rig(["cam"])[0]
    again = opencv_camera("cam", opencv_matrix(camera), camera.world_to_camera, (96, 64))
    np.testing.assert_array_equal(again.intrinsics, camera.intrinsics)


def test_sizes_after_scaling_down() -> None:
    assert scaled_size(2704, 2028, 2) == (1352, 1014)
    assert scaled_size(1345, 1008, 2) == (672, 504)
    assert scaled_size(3, 2, 64) == (1, 1)


def test_pictures_at_full_size_without_distortion_pass_unchanged() -> None:
    image = _picture(_camera(np.zeros(5)))
    assert undistortion(_camera(np.zeros(5)), (240, 160))(image) is image
