"""The dynamic set against true motion, on anchors placed where the truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from streamlod.client.evaluation.measure.footage import Footage
from streamlod.client.evaluation.measure.truth import dynamic_precision_recall, shown_motion
from streamlod.core.camera import Camera
from streamlod.core.frames import PointCloud
from streamlod.core.scene.anchors import Scene
from streamlod.core.train import Trainer, preset
from tests.client.evaluation.conftest import SPEC

Cameras = tuple[Camera, ...]
QUICK = replace(SPEC, fps=4.0)  # the same first frame, and motion that small pictures show


@pytest.fixture(scope="module")
def scene(footage: Footage, many_points: PointCloud) -> Scene:
    training, _ = next(footage.pairs())
    config = preset("balanced")
    config = replace(config, keyframe=replace(config.keyframe, steps=24, growth_interval=8))
    return Trainer(footage.training.cameras, config, 30, "cpu").keyframe(training, many_points).scene


@pytest.fixture(scope="module")
def cameras(footage: Footage) -> tuple[Camera, ...]:
    """Those that trained, in the space of training."""
    return footage.training.cameras


@pytest.fixture(scope="module")
def filmed(footage: Footage) -> tuple[Camera, ...]:
    """The same in the clip's own coordinates."""
    return footage.training.calibrated


def test_the_truth_itself_scores_full_marks(
    scene: Scene, cameras: tuple[Camera, ...], filmed: tuple[Camera, ...]
) -> None:
    seen, moves, visibly = shown_motion(QUICK, scene, 1, cameras, filmed)
    assert (visibly <= moves + 1e-3).all()
    assert (moves <= seen + 1e-3).all()
    truth = (seen > 0.3) & (visibly >= 0.5 * seen)
    assert 0 < truth.sum() < 0.5 * len(truth)
    score = dynamic_precision_recall(QUICK, scene, truth, 1, cameras, filmed)
    assert score.precision == 1
    assert score.recall == 1


def test_half_found_and_everything_dynamic(
    scene: Scene, cameras: tuple[Camera, ...], filmed: tuple[Camera, ...]
) -> None:
    everything = dynamic_precision_recall(QUICK, scene, np.ones(scene.anchor_count, np.bool_), 1, cameras, filmed)
    assert everything.recall == 1
    assert everything.dynamic == scene.anchor_count
    assert 0 < everything.precision < 0.6
    half = np.arange(scene.anchor_count) % 2 == 0
    assert 0.1 < dynamic_precision_recall(QUICK, scene, half, 1, cameras, filmed).recall < 0.9


def test_nothing_found_is_precise_and_recalls_nothing(
    scene: Scene, cameras: tuple[Camera, ...], filmed: tuple[Camera, ...]
) -> None:
    score = dynamic_precision_recall(QUICK, scene, np.zeros(scene.anchor_count, np.bool_), 1, cameras, filmed)
    assert (score.precision, score.recall) == (1, 0)


def test_what_is_not_drawn_need_not_be_found(
    scene: Scene, cameras: tuple[Camera, ...], filmed: tuple[Camera, ...]
) -> None:
    buried = replace(scene, levels=tuple(replace(level, alive=~level.alive) for level in scene.levels))
    nothing = np.zeros(sum(len(level) for level in scene.levels), np.bool_)
    assert dynamic_precision_recall(SPEC, buried, nothing, 1, cameras, filmed).moving == 0


def test_nothing_moves_in_a_still_clip(scene: Scene, cameras: Cameras, filmed: Cameras) -> None:
    some = np.arange(scene.anchor_count) < 10
    score = dynamic_precision_recall(replace(SPEC, still=True), scene, some, 1, cameras, filmed)
    assert (score.dynamic, score.right, score.moving, score.found) == (10, 0, 0, 0)
    assert (score.precision, score.recall) == (0, 1)


def test_flags_that_do_not_fit_are_refused(
    scene: Scene, cameras: tuple[Camera, ...], filmed: tuple[Camera, ...]
) -> None:
    with pytest.raises(ValueError, match="do not fit"):
        dynamic_precision_recall(SPEC, scene, np.zeros(3, np.bool_), 1, cameras, filmed)
