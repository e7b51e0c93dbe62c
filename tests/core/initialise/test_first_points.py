"""First points against a scene whose depth is known, and on real recordings."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from streamlod.core.camera import look_at, pinhole
from streamlod.core.data import open_dataset
from streamlod.core.errors import InputError
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.initialise import first_points
from streamlod.core.initialise.bounds import geometric_bounds
from streamlod.core.initialise.views import inside, project
from streamlod.core.synthetic import SyntheticSpec, ground_truth, open_synthetic

SPEC = SyntheticSpec(cameras=4, frames=1, width=112, height=63)
PIXELS = SPEC.cameras * SPEC.width * SPEC.height
DATASET = open_synthetic(SPEC)


@pytest.fixture(scope="module")
def frame() -> FrameSet:
    return next(iter(DATASET.frames()))


@pytest.fixture(scope="module")
def swept(frame: FrameSet) -> PointCloud:
    return first_points(frame, DATASET.cameras, depth_bounds=DATASET.depth_bounds, method="sweep")


def surface_error(points: PointCloud) -> np.ndarray:
    """[N] the least relative distance, over the cameras, between a point's depth and the true depth there."""
    error = np.full(len(points), np.inf)
    for index, camera in enumerate(DATASET.cameras):
        pixels, depth = project(camera, points.positions.astype(np.float64))
        seen = inside(camera, pixels, depth)
        column, row = pixels[seen].astype(int).T
        truth = ground_truth(SPEC, 0, index).depth[row, column]
        error[seen] = np.minimum(error[seen], np.abs(depth[seen] / truth - 1))
    return error


@pytest.mark.long
def test_swept_points_lie_on_the_surfaces(swept: PointCloud) -> None:
    error = surface_error(swept)
    assert len(swept) > 0.21 * PIXELS
    assert (error < 0.02).mean() > 0.9
    assert (error < 0.05).mean() > 0.96


@pytest.mark.long
def test_swept_points_carry_the_colours_of_the_pictures(frame: FrameSet, swept: PointCloud) -> None:
    camera = DATASET.cameras[0]
    pixels, depth = project(camera, swept.positions.astype(np.float64))
    seen = inside(camera, pixels, depth)
    column, row = pixels[seen].astype(int).T
    visible = np.abs(depth[seen] / ground_truth(SPEC, 0, 0).depth[row, column] - 1) < 0.02
    difference = np.abs(frame.images[0][row, column] / 255 - swept.colours[seen])[visible]
    assert np.median(difference) < 0.03


@pytest.mark.long
def test_bounds_need_not_be_known(frame: FrameSet) -> None:
    points = first_points(frame, DATASET.cameras, depth_bounds=None, method="sweep")
    assert len(points) > 0.17 * PIXELS
    assert (surface_error(points) < 0.05).mean() > 0.94


@pytest.mark.long
def test_absent_cameras_are_left_out(frame: FrameSet, swept: PointCloud) -> None:
    present = np.array([True, True, True, False])
    images = np.where(present[:, None, None, None], frame.images, np.uint8(0))
    points = first_points(
        FrameSet(0, 0, images, present), DATASET.cameras, depth_bounds=DATASET.depth_bounds, method="sweep"
    )
    assert 0.014 * PIXELS < len(points) < len(swept)
    assert points.colours.mean() > 0.5 * swept.colours.mean()


def test_auto_keeps_the_points_of_the_data_set(frame: FrameSet) -> None:
    known = PointCloud(np.array([[0, 2, 1]], np.float32), np.array([[1, 0, 0]], np.float32))
    two = FrameSet(0, 0, frame.images[:2], frame.present[:2])
    points = first_points(two, DATASET.cameras[:2], depth_bounds=DATASET.depth_bounds, dataset_points=known)
    assert len(points) > 1000
    assert (points.positions == known.positions).all(axis=1).any()
    only = first_points(frame, DATASET.cameras, depth_bounds=None, method="colmap", dataset_points=known)
    np.testing.assert_array_equal(only.positions, known.positions)


def test_flat_pictures_fall_back_on_random_points_with_a_warning(
    frame: FrameSet, caplog: pytest.LogCaptureFixture
) -> None:
    flat = FrameSet(0, 0, np.full_like(frame.images, 128), frame.present)
    near, far = 2.0, 7.0
    with caplog.at_level(logging.WARNING):
        points = first_points(flat, DATASET.cameras, depth_bounds=(near, far), method="random", seed=3)
    assert "random points" in caplog.text
    np.testing.assert_allclose(points.colours, 128 / 255, atol=1e-6)
    views = np.zeros(len(points))
    for camera in DATASET.cameras:
        views += inside(camera, *project(camera, points.positions.astype(np.float64)))
    assert views.min() >= 2
    again = first_points(flat, DATASET.cameras, depth_bounds=(near, far), method="random", seed=3)
    np.testing.assert_array_equal(points.positions, again.positions)


@pytest.mark.long
def test_poses_of_other_axes_are_doubted(frame: FrameSet, caplog: pytest.LogCaptureFixture) -> None:
    """As of a program that has OpenGL's axes, written without turning them."""
    turn = np.diag([1.0, -1, -1, 1])
    cameras = [replace(camera, world_to_camera=turn @ camera.world_to_camera) for camera in DATASET.cameras]
    doubt = "are the cameras where their poses say? `streamlod check` tells"
    with caplog.at_level(logging.WARNING):
        first_points(frame, DATASET.cameras, depth_bounds=DATASET.depth_bounds)
        assert doubt not in caplog.text
        first_points(frame, cameras, depth_bounds=DATASET.depth_bounds)
    assert doubt in caplog.text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "magic"}, "neither one of"),
        ({"method": "colmap"}, "the data set has none"),
        ({"depth_bounds": (3.0, 1.0)}, "positive and in order"),
        ({"method": "nowhere.ply"}, "cannot be read"),
    ],
)
def test_refusals_say_what_is_wrong(frame: FrameSet, options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        first_points(frame, DATASET.cameras, **{"depth_bounds": None, **options})


def test_one_camera_has_no_depth(frame: FrameSet) -> None:
    present = np.array([True, False, False, False])
    with pytest.raises(InputError, match="one camera alone"):
        first_points(FrameSet(0, 0, frame.images, present), DATASET.cameras, depth_bounds=None)


@pytest.mark.parametrize("bounds", [None, (1.0, 8.0)])
def test_cameras_in_one_place_have_no_depth(frame: FrameSet, bounds: tuple[float, float] | None) -> None:
    with pytest.raises(InputError, match="at different places"):
        first_points(
            FrameSet(0, 0, frame.images[[0, 0]], frame.present[[0, 0]]),
            (DATASET.cameras[0], replace(DATASET.cameras[0], name="twin")),
            depth_bounds=bounds,
            method="sweep",
        )


def test_bounds_of_a_ring_hold_what_it_looks_at() -> None:
    up = np.array([0.0, 0.0, 1.0])
    ring = [
        pinhole(
            f"{i}", (300, 300), (160, 120), (320, 240), look_at(3 * np.array([np.cos(a), np.sin(a), 0.1]), 0 * up, up)
        )
        for i, a in enumerate(np.linspace(0, 2 * np.pi, 8, endpoint=False))
    ]
    near, far = geometric_bounds(ring)
    assert 0.1 < near < 2.9
    assert far > 4


@pytest.mark.long
def test_real_inward_facing_rig_with_different_exposures(real_data: Path) -> None:
    dataset = open_dataset(real_data / "caliscope_4cam", downscale=10)
    points = first_points(next(iter(dataset.frames())), dataset.cameras, depth_bounds=None)
    assert len(points) > 300
    centre = np.median(points.positions, axis=0)
    assert np.linalg.norm(centre - [0.2, 0.25, 0.07]) < 2.5  # the room round where the cameras' axes meet, metres
