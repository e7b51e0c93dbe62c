"""Moving pixels: where they are, and that scores are of them alone."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from streamlod.client.evaluation.measure.moving import MIN_PIXELS, MovingPixels, moving_score
from streamlod.core.arrays import Bool, UInt8
from streamlod.core.metrics import psnr
from streamlod.core.synthetic import SyntheticSpec, cameras, ground_truth, render_image

SPEC = SyntheticSpec(cameras=3, frames=12, width=160, height=90, speed=3.0)


@cache
def pictures(index: int) -> UInt8:
    return np.stack([render_image(SPEC, index, camera) for camera in range(SPEC.cameras)])


def test_true_masks_cover_what_moves_and_little_else() -> None:
    movers = MovingPixels(cameras(SPEC), SPEC)
    for index in (0, 1, 7):
        masks = movers.masks(index, pictures(index))
        assert masks is not None
        exact = np.stack([ground_truth(SPEC, max(index, 1), camera).moving for camera in range(3)])
        assert masks[exact].mean() > (0.8 if index == 0 else 0.999)
        assert exact.sum() < masks.sum() < 2.5 * exact.sum()


def test_masks_of_real_video_are_where_pictures_change() -> None:
    movers = MovingPixels(cameras(SPEC), None)
    assert movers.masks(0, pictures(5)) is None
    masks = movers.masks(1, pictures(6))
    assert masks is not None
    exact = np.stack([ground_truth(SPEC, 6, camera).moving for camera in range(3)])
    assert masks[exact].mean() > 0.4  # what moves without changing its look does not show
    assert masks[~exact].mean() < 0.08
    still = movers.masks(2, pictures(6) + np.random.default_rng(0).integers(0, 3, pictures(6).shape, np.uint8))
    assert still is not None
    assert still.mean() < 0.01  # noise is not motion


def test_another_size_of_picture_has_masks_too() -> None:
    small = tuple(camera.scaled(80, 45) for camera in cameras(SPEC))
    masks = MovingPixels(small, SPEC).masks(3, np.zeros((3, 45, 80, 3), np.uint8))
    assert masks is not None
    assert masks.shape == (3, 45, 80)
    assert masks.any()


@pytest.fixture
def square() -> Bool:
    mask = np.zeros((2, 90, 160), np.bool_)
    mask[0, 30:50, 60:90] = True
    return mask


def test_only_errors_on_moving_pixels_count(square: Bool) -> None:
    truth = pictures(4)[:2]
    elsewhere = np.where(square[..., None], truth, 255 - truth)
    score = moving_score(list(elsewhere), truth, square)
    assert score is not None
    assert score.psnr == 100
    assert score.share == pytest.approx(square.mean())
    there = np.where(square[..., None], 255 - truth, truth)
    worse = moving_score(list(there), truth, square)
    assert worse is not None
    assert worse.psnr == pytest.approx(psnr((255 - truth)[0, 30:50, 60:90], truth[0, 30:50, 60:90]))
    assert worse.ssim < score.ssim


def test_lpips_sees_the_box_round_the_moving_pixels_with_the_rest_as_it_should_be(square: Bool) -> None:
    truth = pictures(4)[:2]
    seen: list[tuple[UInt8, UInt8]] = []

    def distance(picture: UInt8, true: UInt8) -> float:
        seen.append((picture, true))
        return 0.25

    score = moving_score(list(255 - truth), truth, square, distance)
    assert score is not None
    assert score.lpips == 0.25
    assert len(seen) == 1  # nothing moves in the second picture
    picture, true = seen[0]
    assert picture.shape == true.shape == (64, 64, 3)
    assert (picture != true).any(axis=2).sum() == pytest.approx(20 * 30, abs=20)


def test_what_hardly_moves_is_not_scored(square: Bool) -> None:
    truth = pictures(4)[:2]
    assert moving_score(list(truth), truth, None) is None
    assert moving_score(list(truth), truth, np.zeros_like(square)) is None
    few = np.zeros_like(square)
    few.reshape(2, -1)[:, : MIN_PIXELS - 1] = True
    assert moving_score(list(truth), truth, few) is None
