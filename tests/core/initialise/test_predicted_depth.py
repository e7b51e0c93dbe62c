"""Placing predicted depth into known cameras, with a simulated prediction."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.core.errors import InputError
from streamlod.core.initialise.predicted_depth import (
    PredictedDepth,
    fit_scale_and_shift,
    global_scale,
    model_views,
    place_depth,
    predicted_points,
)
from streamlod.core.initialise.views import WorkingViews, inside, project
from streamlod.core.synthetic import SyntheticSpec, ground_truth, open_synthetic

SPEC = SyntheticSpec(cameras=4, frames=1, width=112, height=70)
DATASET = open_synthetic(SPEC)
UNIT = 3.7  # metres per unit of the simulated prediction


def prediction() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True depth in other units, with a scale and a shift of its own a view, and a noise of 0.3 %."""
    generator = np.random.default_rng(5)
    truth = np.stack([ground_truth(SPEC, 0, index).depth for index in range(4)]).astype(np.float64)
    scale, shift = np.array([1.03, 0.97, 1.01, 0.98]), np.array([0.05, -0.04, 0.0, 0.06])
    depth = (truth - shift[:, None, None]) / scale[:, None, None] / UNIT
    poses = np.stack([camera.world_to_camera for camera in DATASET.cameras])
    poses[:, :3, 3] /= UNIT
    return depth * (1 + 0.003 * generator.standard_normal(depth.shape)), scale * UNIT, poses


def test_global_scale_comes_from_the_centres() -> None:
    assert global_scale(DATASET.cameras, prediction()[2]) == pytest.approx(UNIT, rel=1e-9)


def test_scale_and_shift_of_each_view_are_found() -> None:
    depth, expected, _ = prediction()
    scale, shift = fit_scale_and_shift(DATASET.cameras, depth, UNIT)
    for index in range(4):
        truth = ground_truth(SPEC, 0, index).depth
        error = np.abs((scale[index] * depth[index] + shift[index]) / truth - 1)
        assert np.median(error) < 0.015
    assert np.abs(scale / expected - 1).max() < 0.02


def test_placed_points_lie_on_the_surfaces_and_doubtful_ones_are_dropped() -> None:
    depth, _, poses = prediction()
    views = WorkingViews(DATASET.cameras, next(iter(DATASET.frames())).images.astype(np.float32) / 255)
    confidence = np.ones(depth.shape, np.float32)
    confidence += np.random.default_rng(1).random(depth.shape).astype(np.float32)
    depth[:, 20:30, 20:40] *= 0.5
    confidence[:, 20:30, 20:40] = 0.1
    points = place_depth(views, PredictedDepth(depth.astype(np.float32), confidence, poses))
    error = np.full(len(points), np.inf)
    for index, camera in enumerate(DATASET.cameras):
        pixels, z = project(camera, points.positions.astype(np.float64))
        seen = inside(camera, pixels, z)
        column, row = pixels[seen].astype(int).T
        error[seen] = np.minimum(error[seen], np.abs(z[seen] / ground_truth(SPEC, 0, index).depth[row, column] - 1))
    assert len(points) > 0.4 * depth.size
    assert (error < 0.03).mean() > 0.95


def test_pictures_take_the_size_that_the_model_wants() -> None:
    views = WorkingViews(DATASET.cameras, np.zeros((4, 70, 112, 3), np.float32))
    small = model_views(views, 518)
    assert small.size == (518, 322)
    pixels, depth = project(DATASET.cameras[1], np.array([[0.3, 2.0, 1.0]]))
    again, _ = project(small.cameras[1], np.array([[0.3, 2.0, 1.0]]))
    np.testing.assert_allclose(again / small.size, pixels / views.size)
    assert depth[0] > 0


def test_one_view_alone_is_refused_before_a_model_is_loaded() -> None:
    views = WorkingViews(DATASET.cameras[:1], np.zeros((1, 70, 112, 3), np.float32))
    with pytest.raises(InputError, match="at least two cameras"):
        predicted_points(views, 504, lambda _: pytest.fail("asked for a prediction"))
