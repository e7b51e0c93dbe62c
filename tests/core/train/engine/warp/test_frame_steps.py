"""The steps of one frame in Warp: only dirty tiles are drawn, and the mean of the last numbers comes out."""

from __future__ import annotations

import pytest
import torch

from streamlod.core.train.engine.warp.frame import begin, load_pictures
from streamlod.core.train.engine.warp.frame_steps import FrameSteps, StepSettings, mark_reached, told
from streamlod.core.train.engine.warp.room import view_of
from streamlod.core.train.engine.warp.step import TrainingStep
from streamlod.core.train.optimise.adam import RowAdam
from tests.bench.step_subject import Sizes, make_step
from tests.core.train.engine.warp.rooms import DSSIM, PRICE, small_frame

pytestmark = pytest.mark.long  # compiling the kernels takes a minute

SETTINGS = StepSettings(0.3, 0.7, 0.6, PRICE, DSSIM)
MIDDLE = Sizes(anchors=300, moving=12, slots=4, width=96, height=54, cameras=3)


def test_numbers_are_the_mean_of_the_steps_that_count() -> None:
    frame = small_frame()
    room = frame.loaded(1)
    step, steps, seen = TrainingStep(room), FrameSteps(room, frame.latent, frame.position), []
    for number in range(6):
        loss = steps.take(step, (number % 3,), SETTINGS, counts=number >= 3)
        assert loss.isfinite()
        seen.append(view_of(room.trained.values).view(-1, 27).clone())
    mean, found = torch.stack(seen[3:]).mean(dim=0)[: len(frame.latent)], torch.cat(steps.numbers()[:2], dim=1)
    assert torch.allclose(found, mean, rtol=1e-5, atol=1e-5)


def test_adam_is_told_what_the_usual_one_works_out() -> None:
    frame = small_frame()
    room = frame.loaded(1)
    step = TrainingStep(room)
    steps = FrameSteps(room, frame.latent, frame.position)
    leaf = torch.cat([frame.latent, frame.position], dim=1).requires_grad_()
    usual = RowAdam({"latent": leaf}, SETTINGS.memory)
    rate = StepSettings(0.3, 0.3, SETTINGS.memory, PRICE, DSSIM)
    for number in range(4):
        step.tell(number, told(number, rate), (number % 3,))  # the gradient first, from a step that is not ended
        step.show()
        step.judge()
        step.pull()
        flat = view_of(room.trained.gradient)
        leaf.grad = flat.view(-1, 27)[: len(leaf)].clone()
        flat.zero_()
        view_of(room.trained.totals).zero_()
        steps.take(step, (number % 3,), rate, counts=False)
        usual.step({"latent": rate.latent_rate})
    found = torch.cat(steps.numbers()[:2], dim=1)
    assert torch.allclose(found, leaf.detach(), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("known", [(0, 1, 2), (0, 2)])
def test_a_picture_with_clean_tiles_is_the_whole_picture(known: tuple[int, ...]) -> None:
    step = make_step(MIDDLE, "cpu")
    room, dirty = step.room, view_of(step.room.sight.dirty)
    dirty.fill_(1)
    shown = torch.stack([_shown(step, camera) for camera in range(MIDDLE.cameras)])
    load_pictures(room, 0.5 * shown, shown, None)
    g = torch.Generator().manual_seed(0)
    position = 60 * torch.randn(MIDDLE.moving, 3, generator=g)
    mark_reached(step, MIDDLE.moving)
    dirty[[number not in known for number in range(MIDDLE.cameras)]] = 1
    steps = FrameSteps(room, torch.randn(MIDDLE.moving, 24, generator=g), position)
    for number in range(6):
        steps.take(step, (number % MIDDLE.cameras,), SETTINGS, counts=False)
    clean = dirty == 0
    assert clean[0].any()
    assert bool(clean[1].any()) == (1 in known)
    partly = [_shown(step, camera) for camera in range(MIDDLE.cameras)]
    dirty.fill_(1)
    for camera, picture in enumerate(partly):
        assert torch.equal(picture, _shown(step, camera))
    assert not torch.equal(partly[0], shown[0])
    begin(room, torch.zeros(MIDDLE.moving, 24), torch.zeros(MIDDLE.moving, 3))
    assert torch.equal(_shown(step, 0), shown[0])


def _shown(step: TrainingStep, camera: int) -> torch.Tensor:
    """[H,W,3] what a camera sees now."""
    view_of(step.room.sight.chosen).fill_(camera)
    step.show()
    view_of(step.room.trained.totals).zero_()
    return view_of(step.room.drawn.image)[0].clone()
