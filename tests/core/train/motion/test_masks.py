"""Which pixels and which anchors count as moving."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.core.train.motion.masks import changed_pixels, dynamic_anchors, mixture_thresholds

FLOOR = 0.02


def _picture(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((60, 80, 3), np.float32)


def test_nothing_moves_in_noise_alone() -> None:
    still = 0.5 * _picture()
    noise = np.random.default_rng(1).normal(0, 0.02, (2, *still.shape)).astype(np.float32)
    assert not changed_pixels(still + noise[0], still + noise[1], FLOOR).any()


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
    assert changed_pixels(dark, bright, FLOOR).all()


@pytest.mark.parametrize("outlier", [1.0, 1e30])
def test_the_few_high_scores_are_dynamic(outlier: float) -> None:
    random = np.random.default_rng(2)
    scores = np.concatenate([random.gamma(2, 1e-6, 900), random.gamma(20, 1e-4, 100)])
    scores[-1] *= outlier
    dynamic = dynamic_anchors(scores, np.zeros(1000, bool), 0.8, 0.4)
    assert dynamic[900:].mean() > 0.9
    assert dynamic[:900].mean() < 0.05


@pytest.mark.parametrize("count", [0, 1, 2, 15])
def test_few_samples_are_all_dynamic(count: int) -> None:
    scores = np.linspace(1, 2, count)
    assert dynamic_anchors(scores, np.zeros(count, bool), 0.8, 0.4).all()


def test_identical_scores_are_all_dynamic() -> None:
    assert dynamic_anchors(np.full(50, 0.3), np.zeros(50, bool), 0.8, 0.4).all()


def test_no_scores_and_broken_scores_are_static() -> None:
    scores = np.array([0.0, np.nan, np.inf, -np.inf] * 10)
    assert not dynamic_anchors(scores, np.ones(40, bool), 0.8, 0.4).any()


def test_the_threshold_is_monotone() -> None:
    random = np.random.default_rng(3)
    scores = np.concatenate([random.gamma(2, 1.0, 500), random.gamma(2, 50.0, 60)])
    low, middle, high = mixture_thresholds(scores, 0.5, 0.8, 0.99)
    assert low <= middle <= high


def test_hysteresis_keeps_what_was_dynamic() -> None:
    random = np.random.default_rng(4)
    scores = np.concatenate([random.normal(10, 1, 500), random.normal(16, 2, 100)]) ** 4
    fresh = dynamic_anchors(scores, np.zeros(600, bool), 0.95, 0.05)
    held = dynamic_anchors(scores, np.ones(600, bool), 0.95, 0.05)
    assert (held | ~fresh).all()
    assert held.sum() > fresh.sum()
