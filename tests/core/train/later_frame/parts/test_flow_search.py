"""Where training of a later frame begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from streamlod.client.evaluation.measure.moving import MovingPixels
from streamlod.client.evaluation.measure.scores import draw
from streamlod.codec.encoder import encode_residual
from streamlod.core.arrays import Bool
from streamlod.core.frames import FrameSet
from streamlod.core.render.differentiable import rasterise
from streamlod.core.scene.anchors import Scene
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer, preset
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.later_frame.autograd.engine import AutogradEngine
from streamlod.core.train.later_frame.comparison import Comparison
from streamlod.core.train.later_frame.parts import USUAL, FlowSearch
from streamlod.core.train.later_frame.parts.flow_starts import better_starts, guessed_positions
from streamlod.core.train.later_frame.training import FrameTraining
from tests.core.train.motion.moved import RIG, Moved, moved_state
from tests.core.true_points import true_points


def step(moved: Moved) -> Tensor:
    """[N,1] world units that a step of position is wide."""
    steps = torch.from_numpy(moved.state.scene.header.position_steps).float()
    return steps[moved.state.field.level][:, None]


def guess_of(moved: Moved) -> Tensor:
    masks = (moved.views.targets - moved.state.known.filmed).abs().amax(dim=3) > 0.02
    rows = torch.arange(len(moved.motion))
    pictures = Comparison(moved.views, masks, moved.state.known)
    return guessed_positions(moved.state, rows, pictures, 0.5)


class Whole(AutogradEngine):
    """Draws each camera's picture whole."""

    def __init__(self, moved: Moved) -> None:
        self._moved = moved

    def draw_two(self, number: int, first: Splats, second: Splats) -> tuple[Tensor, Tensor]:
        one, other = (
            rasterise(*splats.astuple(), camera=RIG[number], background=torch.full((3,), 0.2), backend="cpu").image
            for splats in (first, second)
        )
        return one, other

    def target(self, number: int) -> Tensor:
        return self._moved.views.targets[number]


class Rendering(FrameTraining):
    """All anchors of a state in training."""

    def __init__(self, moved: Moved) -> None:
        self._moved, self.numbers, self.engine = moved, list(range(len(RIG))), Whole(moved)

    def splats_at(self, number: int, position: Tensor) -> Splats:
        field = self._moved.state.field
        there = replace(field, position=field.position + position * step(self._moved))
        return there.decode(torch.from_numpy(RIG[number].centre).float())


def test_flow_takes_most_anchors_to_where_they_went() -> None:
    moved = moved_state()
    found = guess_of(moved) * step(moved)
    wrong = (found - moved.motion).norm(dim=1)[moved.moving]
    assert wrong.median() < 0.4 * moved.motion.norm(dim=1).max()


def test_each_anchor_begins_where_the_pictures_want_it() -> None:
    moved = moved_state()
    wide = torch.tensor([0.12, 0.0, 0.06]) / step(moved)  # right for those that moved, wrong for all others
    starts = better_starts(wide, Rendering(moved))
    taken = (starts == wide).all(dim=1)
    assert taken[moved.moving].float().mean() > 0.7
    assert taken[~moved.moving].float().mean() < 0.05
    assert (taken | (starts == 0).all(dim=1)).all()


def test_nothing_is_drawn_where_flow_says_nothing() -> None:
    class Refusing(Rendering):
        def splats_at(self, number: int, position: Tensor) -> Splats:
            raise AssertionError

    assert not better_starts(torch.zeros(4, 3), Refusing(moved_state())).any()


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_what_moves_is_shown_better_by_search() -> None:
    """Search saves error on what moves and bytes; a clip may show only one of them, so their product is compared."""
    assert np.mean([_cost_of_search(seed) for seed in (1, 2)]) < 0.85  # 0.73, of single clips 0.60 and 0.86


def _cost_of_search(seed: int) -> float:
    """Error on what moves times bytes with search, as a share of that without."""
    spec = SyntheticSpec(cameras=4, frames=4, width=192, height=108, seed=seed)
    clip = open_synthetic(spec)
    first, *later = clip.frames()
    config = preset("live")
    config = replace(config, keyframe=replace(config.keyframe, steps=200))
    scene = Trainer(clip.cameras, config, clip.fps, "cpu").keyframe(first, true_points(spec)).scene
    moving = MovingPixels(clip.cameras, spec)
    masks = [moving.masks(frame.index, frame.images) for frame in later]
    cost = []
    for parts in (tuple(part for part in USUAL if not isinstance(part, FlowSearch)), USUAL):
        trainer = Trainer(clip.cameras, replace(config, parts=parts), clip.fps, "cpu")
        trainer.resume(scene)
        trainer.predict(first)  # tells the trainer what the first frame was shown
        trainer.resume(scene, keep_references=True)
        errors, sizes = [], []
        for frame, mask in zip(later, masks, strict=True):
            before, result = trainer.scene, trainer.predict(frame)
            assert result.residual is not None
            sizes.append(len(encode_residual(before, result.residual, time_ns=0)))
            errors.append(_error(result.scene, frame, mask))
        cost.append(np.mean(errors) * np.mean(sizes))
    return float(cost[1] / cost[0])


def _error(scene: Scene, frame: FrameSet, masks: Bool | None) -> float:
    """Mean square error of the pixels that move, in the mean of the cameras."""
    assert masks is not None
    pictures = [draw(scene, camera).astype(np.float64) for camera in scene.header.cameras]
    return float(np.mean([((a - b)[m] ** 2).mean() for a, b, m in zip(pictures, frame.images, masks, strict=True)]))
