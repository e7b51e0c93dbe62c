"""What makes first points trustworthy: bounds on wrong ones in a plain room, and each test of a pixel by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from streamlod.core.camera import look_at, pinhole
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.initialise import METHODS, first_points
from streamlod.core.initialise.consistency import Trust, in_large_pieces, trusted, votes
from streamlod.core.initialise.equalise import equalised
from streamlod.core.initialise.method import PointSources
from streamlod.core.initialise.stereo.sweep import DepthMap, plane_count, sweep_views
from streamlod.core.initialise.stereo.sweep_kernel import best_planes
from streamlod.core.initialise.views import WorkingViews, working_views
from streamlod.core.synthetic import SyntheticSpec, ground_truth, open_synthetic
from tests.bench.first_points_bench import score_points

UP = np.array([0.0, 0.0, 1.0])


def flat_map(x: float, depth: float, cost: float = 0.0) -> DepthMap:
    """A camera at (x, -1, 0) that looks along y and sees a wall across, `depth` before it."""
    eye = np.array([x, -1.0, 0.0])
    camera = pinhole(f"{x}", (20, 20), (10, 10), (20, 20), look_at(eye, eye + np.array([0.0, 1.0, 0.0]), UP))
    return DepthMap(camera, np.full((20, 20), depth, np.float32), np.full((20, 20), cost, np.float32))


@pytest.mark.long
@pytest.mark.parametrize(
    ("width", "free", "off", "covered"),
    [(128, 20.0, 0.09, 0.8), pytest.param(480, 12.0, 0.06, 0.78, marks=pytest.mark.slow)],  # windows widen what is near
)
def test_hardly_any_point_of_a_plain_room_hangs_in_free_space(
    width: int, free: float, off: float, covered: float
) -> None:
    spec = SyntheticSpec(kind="bright", cameras=5, frames=1, width=width, height=width * 9 // 16)
    dataset = open_synthetic(spec)
    frame = next(iter(dataset.frames()))
    points = first_points(frame, dataset.cameras, depth_bounds=dataset.depth_bounds, method="sweep")
    truth = [ground_truth(spec, 0, number).depth for number in range(spec.cameras)]
    score = score_points(points, list(dataset.cameras), truth)
    assert score.points > 128**2
    assert score.free_in_10000 <= free
    assert score.off < off
    assert score.covered > covered


def test_views_vote_for_what_they_see_and_against_what_they_look_through() -> None:
    maps = [flat_map(0, 2.0), flat_map(0.1, 2.0), flat_map(-0.1, 4.0)]
    points = maps[0].points()
    agreeing, through = votes(points, 0, maps, 0.02)
    middle = points.reshape(20, 20, 3)[10, 10]
    row = np.flatnonzero((points == middle).all(axis=1))[0]
    assert (agreeing[row], through[row]) == (1, 1)
    unsure = replace(maps[2], depth=np.full((20, 20), np.inf, np.float32))
    assert votes(points, 0, [*maps[:2], unsure], 0.02)[1].max() == 0


def test_specks_are_not_trusted_however_well_they_match() -> None:
    depth, good = np.full((40, 40), 4.0, np.float32), np.zeros((40, 40), np.bool_)
    good[20:], good[:5, :5], good[:2, 10:15] = True, True, True
    depth[:5, 3:5] = 3.9  # beyond the tolerance: another surface
    kept = in_large_pieces(depth, good, Trust(smallest_piece=15 / 1600))
    assert kept[20:].all()
    assert kept[:5, :3].all()
    assert not kept[:5, 3:].any()


def test_a_near_piece_must_be_larger_than_a_far_one() -> None:
    depth, good = np.full((40, 40), 4.0, np.float32), np.zeros((40, 40), np.bool_)
    good[20:], good[:5, :5], good[:5, 10:15] = True, True, True
    depth[:5, :5] = 1.0  # 25 pixels, worth 25 / 16 of those at the median depth
    kept = in_large_pieces(depth, good, Trust(smallest_piece=20 / 1600))
    assert kept[:5, 10:15].all()
    assert not kept[:5, :5].any()


def test_a_poor_match_needs_more_than_one_view_that_confirms_it() -> None:
    one, more = [flat_map(0, 2.0, 0.5), flat_map(0.1, 2.0, 0.5)], [flat_map(x, 2.0, 0.5) for x in (0, 0.1, -0.1)]
    middle = np.ravel_multi_index((10, 10), (20, 20))
    assert not trusted(one[0].points(), 0, one, Trust())[middle]
    assert trusted(more[0].points(), 0, more, Trust())[middle]


def test_planes_lie_a_pixel_of_parallax_apart() -> None:
    views = WorkingViews((flat_map(0, 1).camera, flat_map(1, 1).camera), np.zeros((2, 20, 20, 3), np.float32))
    assert plane_count(views, (0.1, 10.0), 384) == 198  # 20 pixels, 1 unit apart, inverse depths 0.1 to 10
    assert plane_count(views, (0.1, 10.0), 100) == 100
    assert plane_count(views, (5.0, 10.0), 384) == 64


def test_best_planes_are_those_of_numpy() -> None:
    volume = np.random.default_rng(0).random((30, 7, 9), np.float32)
    plane, cost, rival = np.empty((7, 9), np.int64), np.empty((7, 9), np.float32), np.empty((7, 9), np.float32)
    best_planes(volume, 3, plane, cost, rival)
    np.testing.assert_array_equal(plane, volume.argmin(axis=0))
    np.testing.assert_array_equal(cost, volume.min(axis=0))
    far = np.abs(np.arange(30)[:, None, None] - plane) > 3
    np.testing.assert_array_equal(rival, np.where(far, volume, np.inf).min(axis=0))


def test_exposures_are_told_apart_by_matched_pixels() -> None:
    spec = SyntheticSpec(cameras=4, frames=1, width=160, height=90, noise=0.0)
    dataset = open_synthetic(spec)
    views = working_views(next(iter(dataset.frames())), dataset.cameras, 90)
    gains = np.array([1.0, 0.8, 1.1, 0.95], np.float32)
    uneven = replace(views, images=views.images * gains[:, None, None, None])
    assert dataset.depth_bounds is not None
    maps = sweep_views(views, dataset.depth_bounds, 96)
    even = equalised(uneven, uneven, maps).images.mean(axis=(1, 2, 3)) / views.images.mean(axis=(1, 2, 3))
    np.testing.assert_allclose(even / even.mean(), 1.0, atol=0.03)


def test_a_method_may_be_a_function_of_ones_own() -> None:
    def one(sources: PointSources) -> PointCloud:
        return PointCloud(np.full((1, 3), sources.seed, np.float32), np.zeros((1, 3), np.float32))

    frame = FrameSet(0, 0, np.zeros((1, 20, 20, 3), np.uint8), np.ones(1, np.bool_))
    found = first_points(frame, [flat_map(0, 1).camera], depth_bounds=None, method=one, seed=7)
    np.testing.assert_array_equal(found.positions, [[7, 7, 7]])
    assert set(METHODS) == {"auto", "colmap", "sweep", "colmap+sweep", "learned", "vggt", "depth-anything", "random"}


@pytest.mark.parametrize("seen", [1, 2])
def test_what_only_one_neighbour_sees_is_found_too(seen: int) -> None:
    """A wall at the middle camera's left edge, which the camera on the right does not see."""
    spec = SyntheticSpec(cameras=3, frames=1, width=160, height=90, noise=0.0)
    dataset = open_synthetic(spec)
    views = working_views(next(iter(dataset.frames())), dataset.cameras, 90)
    assert dataset.depth_bounds is not None
    chosen = WorkingViews(views.cameras[: seen + 1], views.images[: seen + 1])
    depth = sweep_views(chosen, dataset.depth_bounds, 128)[0]
    right = np.abs(depth.depth / ground_truth(spec, 0, 0).depth - 1) < 0.03
    assert right[:, 40:120].mean() > 0.55
