"""Derivatives of projection and of bundle adjustment, against differences; rotations; parabolas of tracks."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.sparse import csr_matrix

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment import residuals as bundle
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.adjustment.bounds import LinearBounds
from streamlod.core.calibration.adjustment.minimise import minimise
from streamlod.core.calibration.adjustment.observations import curve_noise, observed
from streamlod.core.calibration.adjustment.projection import matrix_of, projected
from streamlod.core.calibration.adjustment.unfolded import unfolded_lenses
from streamlod.core.calibration.track import Track
from tests.core.calibration.walks import BOARD, board_at, rig, walked

LENS = np.array([500.0, 510, 320, 240, -0.2, 0.05, 0.002, -0.003, 0.01])


def test_projection_is_opencv_s_with_its_derivatives() -> None:
    points = np.random.default_rng(0).normal([0, 0, 3], [0.7, 0.7, 0.4], (40, 3))
    pixels, by_point, by_lens = projected(LENS, points)
    wanted, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix_of(LENS), LENS[4:])
    np.testing.assert_allclose(pixels, wanted[:, 0], atol=1e-9)
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        slope = (projected(LENS, points + step)[0] - projected(LENS, points - step)[0]) / 2e-6
        np.testing.assert_allclose(by_point[:, :, axis], slope, rtol=1e-5, atol=1e-4)
    for value in range(9):
        step = 1e-6 * np.eye(9)[value]
        slope = (projected(LENS + step, points)[0] - projected(LENS - step, points)[0]) / 2e-6
        np.testing.assert_allclose(by_lens[:, :, value], slope, rtol=1e-5, atol=1e-4)


def test_jacobian_of_the_adjustment_is_that_of_its_residuals() -> None:
    truth, times = rig(2), np.array([1.02, 2.03, 3.01])
    tracks = walked(truth, seconds=5)
    readouts = np.array([[0.002, 0.03], [-0.02, 0.004]])
    scene = bundle.AdjustedRig(truth.lenses, truth.poses, np.array([0.01, -0.02]), readouts, board_at(times))
    seen = observed(tracks, times, scene.offsets, BOARD.corners)
    flat = bundle.flat_values(scene)
    jacobian = bundle.jacobian_of(scene, seen, len(flat)).toarray()
    for place in range(len(flat)):
        step = np.zeros(len(flat))
        step[place] = 1e-6
        after, before = (bundle.misses_of(bundle.scene_of(flat + s, 2), seen).ravel() for s in (step, -step))
        np.testing.assert_allclose(jacobian[:, place], (after - before) / 2e-6, rtol=1e-4, atol=2e-3)


def test_transforms_compose_and_turn_back() -> None:
    random = np.random.default_rng(1)
    a, b = random.normal(0, 1, (5, 6)), random.normal(0, 1, (5, 6))
    for one, other, both in zip(a, b, rigid.after(a, b), strict=True):
        np.testing.assert_allclose(rigid.matrix(both), rigid.matrix(one) @ rigid.matrix(other), atol=1e-12)
    np.testing.assert_allclose(rigid.after(a, rigid.inverse(a)), 0, atol=1e-12)
    assert np.isnan(rigid.after(a[0], np.full((1, 6), np.nan))).all()


def test_tracks_are_parabolas_between_pictures() -> None:
    times = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    path = 5 + 30 * times - 40 * times**2
    corners = np.broadcast_to(path[:, None, None], (5, 1, 2)).copy()
    track = Track("a", (100, 100), times, corners)
    wanted = np.array([0.13, 0.24])
    found = track.near(wanted).at(wanted)[:, 0, 0]
    np.testing.assert_allclose(found, 5 + 30 * wanted - 40 * wanted**2, atol=1e-9)
    corners[3] = np.nan  # the corner at 0.2 s has one neighbour: a line holds near it alone
    straight = track.near(np.array([0.205, 0.23]))
    assert np.isfinite(straight.value[0]).all()
    assert np.isnan(straight.value[1]).all()
    corners[[1, 3]] = np.nan  # the corner at 0.2 s stands alone: it counts at its picture's time only
    alone = track.near(np.array([0.2, 0.24]))
    assert np.isfinite(alone.value[0]).all()
    assert np.isnan(alone.value[1]).all()


def test_how_far_corners_leave_their_curves_is_known() -> None:
    times = np.array([0.0, 0.3, 0.7, 1.0, 1.3, 1.7, 2.0])
    path = 5 + 30 * times - 40 * times**2 + 50 * times**3
    corners = np.stack([path, 2 * path], axis=1)[:, None]
    wanted = np.array([0.1, 0.85, 1.3, 1.5])  # before the first one nothing tells
    curve = Track("a", (100, 100), times, corners).near(wanted)
    exact = np.stack([5 + 30 * wanted - 40 * wanted**2 + 50 * wanted**3] * 2, axis=1) * [1, 2]
    off = np.linalg.norm(curve.at(wanted)[:, 0] - exact, axis=1)
    np.testing.assert_allclose(curve.error[1:, 0], off[1:], atol=1e-9)
    assert curve.error[0] == 0
    assert off[1] > 1


def test_curves_between_pictures_of_a_fast_camera_are_as_noisy_as_at_them() -> None:
    """If they were less so, cameras would be found to read their pictures slowly, which takes times away from these."""
    times = np.arange(4000) / 30
    noise = np.random.default_rng(0).normal(0, 0.3, (4000, 1, 2))
    track = Track("a", (100, 100), times, 5 + 30 * times[:, None, None] + noise)
    scatter = []
    for late in (0.0, 0.5 / 30):
        wanted = times[10:-10] + late
        scatter.append(np.std(track.near(wanted).at(wanted)[:, 0, 0] - 5 - 30 * wanted))
    assert scatter[1] / scatter[0] > 0.93


@pytest.mark.parametrize("lost", [(), (9,), (11,)], ids=["both neighbours", "none before", "none behind"])
def test_noise_of_curves_is_known(lost: tuple[int, ...]) -> None:
    times = np.arange(20) / 10
    corners = np.random.default_rng(0).normal(0, 0.3, (20, 5000, 2))
    corners[list(lost)] = np.nan
    track = Track("a", (100, 100), times, corners)
    for late in (-0.009, 0.0, 0.004, 0.03, -0.04)[: 3 if lost else 5]:
        curve = track.near(times[10:11] + late)
        noise, growth = curve_noise(np.array([late]), curve.neighbours[:, 0])
        if noise < 1:  # what goes on beyond its pictures counts as one of them
            assert np.nanstd(curve.at(times[10:11] + late)) / 0.3 == pytest.approx(noise.item(), abs=0.02)
            longer, _ = curve_noise(np.array([late + 1e-6]), curve.neighbours[:, 0])
            assert (longer - noise).item() == pytest.approx(1e-6 * growth.item(), rel=1e-3)


def test_bounds_of_lenses_hold_back_those_that_fold_and_no_others() -> None:
    sizes = [(640, 480), (1280, 720)]
    sound = np.array([LENS, [903.5, 907.9, 618.3, 394.2, -0.332, 0.046, -0.004, 0.004, 0.067]])
    folding = sound.copy()
    folding[:, 4:] = [-0.5, 0.0, 0.0, 0.0, 0.0]
    bounds = unfolded_lenses(sound, sizes, 9)
    assert (bounds.rows @ sound.ravel() >= bounds.least).all()
    assert (bounds.rows @ folding.ravel() < bounds.least).reshape(2, -1).any(axis=1).all()
    mended = bounds.within(folding.ravel())
    assert (bounds.rows @ mended >= bounds.least - 1e-9).all()
    np.testing.assert_array_equal(bounds.within(sound.ravel()), sound.ravel())


@pytest.mark.parametrize("seed", range(4))
def test_a_search_ends_at_the_least_cost_within_bounds(seed: int) -> None:
    random = np.random.default_rng(seed)
    slopes, wanted = random.normal(0, 1, (30, 10)), random.normal(0, 1, 30)
    slopes[:, 0] *= 1e3  # values of other units
    rows = random.normal(0, 1, (8, 4)) / [1e-3, 1, 1, 1]
    bounds = LinearBounds(rows, random.uniform(-0.3, -0.01, 8))
    start = random.normal(0, 1, 10)  # outside of some

    def residuals(values: Float64) -> Float64:
        return np.asarray(slopes @ values - wanted, np.float64)

    found = minimise(start, residuals, lambda _: csr_matrix(slopes), np.full(30, np.inf), 1, bounds)
    free = np.linalg.lstsq(slopes, wanted, rcond=None)[0]
    units = np.array([1e-3, *np.ones(9)])
    inside = {"type": "ineq", "fun": lambda x: rows @ (x * units)[:4] - bounds.least}
    best = minimize(lambda x: (residuals(x * units) ** 2).sum(), free / units, constraints=[inside], tol=1e-14)
    assert (rows @ free[:4] < bounds.least).any()
    assert (rows @ found.values[:4] >= bounds.least - 1e-9).all()
    assert (found.residuals**2).sum() == pytest.approx(best.fun, rel=1e-6)
