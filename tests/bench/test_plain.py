"""Plain Gaussians learn a small scene within their time, from points that were thinned."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count

import numpy as np
import pytest

from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.metrics import psnr
from streamlod.core.synthetic import SyntheticSpec, cameras, open_synthetic
from tests.bench.zoo.plain import PlainConfig, PlainGaussians, plain_views, thinned
from tests.core.true_points import true_points

SPEC = SyntheticSpec(cameras=4, frames=3, width=64, height=36)


@pytest.fixture(scope="module")
def instants() -> list[FrameSet]:
    return list(open_synthetic(SPEC).frames())


@pytest.fixture(scope="module")
def points() -> PointCloud:
    return true_points(SPEC)


def clock(step_seconds: float) -> Callable[[], float]:
    """A clock by which each step takes as long."""
    looks = count()
    return lambda: step_seconds * next(looks)


def test_it_learns_the_scene_and_follows_it(instants: list[FrameSet], points: PointCloud) -> None:
    rig = cameras(SPEC)
    views = plain_views(instants[0], rig)
    model = PlainGaussians(points, views, clock=clock(0.01))
    model.train(0.05)
    early = psnr(model.picture(rig[1]), instants[0].images[1])
    model = PlainGaussians(points, views, clock=clock(0.01))
    assert model.train(2.0) == pytest.approx(200, abs=1)
    late = psnr(model.picture(rig[1]), instants[0].images[1])
    assert late > max(early, 20)
    before = psnr(model.picture(rig[0]), instants[2].images[0])
    model.follow(plain_views(instants[2], rig), 0.5)
    assert psnr(model.picture(rig[0]), instants[2].images[0]) > before


def test_thinning_leaves_one_point_a_cell_and_keeps_the_mean() -> None:
    rig = cameras(SPEC)
    generator = np.random.default_rng(0)
    near = generator.uniform(-0.5, 0.5, (4000, 3)) + np.array([0, 0, 1])
    far = near + np.array([0, 60, 0])
    positions = np.concatenate([near, far]).astype(np.float32)
    cloud = PointCloud(positions, generator.uniform(0, 1, positions.shape).astype(np.float32))
    thin = thinned(cloud, rig, 4.0)
    close = (thin.positions[:, 1] < 30).sum()
    assert close > 10 * (len(thin) - close) > 0  # cells grow with distance
    assert np.allclose(thin.colours.mean(), 0.5, atol=0.05)
    assert len(thinned(cloud, rig, 0.0)) == len(cloud)


def test_the_result_is_the_mean_of_the_last_steps(instants: list[FrameSet], points: PointCloud) -> None:
    config = PlainConfig(average_from=0.0, half_size_until=0.0)
    model = PlainGaussians(points, plain_views(instants[0], cameras(SPEC)), config, clock=clock(0.01))
    model.train(0.2)
    assert model._optimiser.mean["means"].shape == model._optimiser.parameters["means"].shape
    assert not np.allclose(model._optimiser.mean["means"], model._optimiser.parameters["means"].detach())
