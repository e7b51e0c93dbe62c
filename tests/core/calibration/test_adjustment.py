"""Derivatives of projection and of bundle adjustment, against differences; rotations; parabolas of tracks."""

from __future__ import annotations

import cv2
import numpy as np

from streamlod.core.calibration.adjustment import adjust as bundle
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.adjustment.observations import observed
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
    flat = bundle._flat(scene)
    jacobian = bundle._jacobian(scene, seen, len(flat)).toarray()
    for place in range(len(flat)):
        step = np.zeros(len(flat))
        step[place] = 1e-6
        after, before = (bundle.misses_of(bundle._scene(flat + s, 2), seen).ravel() for s in (step, -step))
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


def test_bounds_of_lenses_hold_back_those_that_fold_and_no_others() -> None:
    sizes = [(640, 480), (1280, 720)]
    sound = np.array([LENS, [903.5, 907.9, 618.3, 394.2, -0.332, 0.046, -0.004, 0.004, 0.067]])
    folding = sound.copy()
    folding[:, 4:] = [-0.5, 0.0, 0.0, 0.0, 0.0]
    bounds = unfolded_lenses(sound, sizes, 9, 18)
    assert bounds.misses(sound.ravel()).max() == 0
    assert bounds.misses(folding.ravel()).reshape(2, -1).max(axis=1).min() > 0
    slopes = bounds.slopes(folding.ravel()).toarray()
    for place in range(18):
        step = 1e-6 * np.eye(18)[place]
        after, before = (bounds.misses(folding.ravel() + sign * step) for sign in (1, -1))
        np.testing.assert_allclose(slopes[:, place], (after - before) / 2e-6, atol=1e-3)
