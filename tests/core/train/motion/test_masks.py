"""Which pixels and which anchors count as moving."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.train.motion.masks import (
    change_masks,
    changed_pixels,
    dynamic_anchors,
    least_change,
    mixture_threshold,
    noise_between,
)
from streamlod.core.train.pictures.views import Views

FLOOR = 0.02


def _picture(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((60, 80, 3), np.float32)


def _camera() -> Camera:
    pose = look_at(np.array([0.0, 0, -3]), np.zeros(3), np.array([0.0, -1, 0]))
    return pinhole("cam", (80, 80), (40, 30), (80, 60), pose)


def _noisy(picture: np.ndarray, seed: int) -> np.ndarray:
    return (picture + np.random.default_rng(seed).normal(0, 0.02, picture.shape)).astype(np.float32)


def _noise(before: np.ndarray, now: np.ndarray) -> float:
    return float(noise_between(*(torch.from_numpy(picture)[None] for picture in (before, now)))[0])


def test_nothing_moves_in_noise_alone() -> None:
    before, now = (_noisy(0.5 * _picture(), seed) for seed in (1, 2))
    assert not changed_pixels(before, now, least_change(_noise(before, now), FLOOR)).any()


def test_noise_is_that_of_averages_and_does_not_grow_by_what_moves() -> None:
    before, now = (_noisy(0.5 * _picture(), seed) for seed in (1, 2))
    of_one_channel = 0.02 * 2**0.5 / 5
    assert of_one_channel < _noise(before, now) < 2 * of_one_channel  # the largest of three counts
    now[:20] += 0.4
    assert of_one_channel < _noise(before, now) < 2.5 * of_one_channel


def test_pictures_smaller_than_the_blur_have_a_noise() -> None:
    assert _noise(np.zeros((3, 4, 3), np.float32), np.full((3, 4, 3), 0.5, np.float32)) > 0.5


def test_what_drifts_hides_no_change() -> None:
    """Shade drifts over three quarters of a picture; its camera is no noisier for it, so that a patch is still seen."""
    reference = np.full((60, 80, 3), 0.5, np.float32)
    before = reference.copy()
    before[:, :60] += 0.015
    now = before.copy()
    now[20:40, 20:40] += 0.05
    camera, pictures = _camera(), (torch.from_numpy(part)[None] for part in (reference, before, now))
    references, latest, targets = pictures
    mask = change_masks(references, latest, Views((camera,), targets, [0]), FLOOR)[0].numpy()
    assert mask[22:38, 22:38].all()
    assert not mask[:12].any()


def test_identical_pictures_have_no_change() -> None:
    assert not changed_pixels(_picture(), _picture(), FLOOR).any()


def test_a_moving_patch_is_found_where_it_is() -> None:
    before = np.full((60, 80, 3), 0.5, np.float32)
    after = before.copy()
    after[20:32, 40:52] = 0.8
    mask = changed_pixels(before, after, FLOOR)
    assert mask[22:30, 42:50].all()
    assert not mask[:10].any()
    assert not mask[:, :25].any()


def test_a_flash_changes_everything() -> None:
    dark, bright = np.zeros((60, 80, 3), np.float32), np.ones((60, 80, 3), np.float32)
    assert changed_pixels(dark, bright, least_change(_noise(dark, bright), FLOOR)).all()


@pytest.mark.parametrize("outlier", [1.0, 1e30])
def test_the_few_high_scores_are_dynamic(outlier: float) -> None:
    random = np.random.default_rng(2)
    scores = np.concatenate([random.gamma(2, 1e-6, 900), random.gamma(20, 1e-4, 100)])
    scores[-1] *= outlier
    dynamic = dynamic_anchors(scores, 0.8)
    assert dynamic[900:].mean() > 0.9
    assert dynamic[:900].mean() < 0.05


@pytest.mark.parametrize("count", [0, 1, 2, 15])
def test_few_samples_are_all_dynamic(count: int) -> None:
    scores = np.linspace(1, 2, count)
    assert dynamic_anchors(scores, 0.8).all()


def test_identical_scores_are_all_dynamic() -> None:
    assert dynamic_anchors(np.full(50, 0.3), 0.8).all()


def test_no_scores_and_broken_scores_are_static() -> None:
    scores = np.array([0.0, np.nan, np.inf, -np.inf] * 10)
    assert not dynamic_anchors(scores, 0.8).any()


def test_the_threshold_is_monotone() -> None:
    random = np.random.default_rng(3)
    scores = np.concatenate([random.gamma(2, 1.0, 500), random.gamma(2, 50.0, 60)])
    low, middle, high = (mixture_threshold(scores, posterior) for posterior in (0.5, 0.8, 0.99))
    assert low <= middle <= high
