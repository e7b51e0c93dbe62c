"""Cameras that drift are told from light, from what moves and from noise, and their pictures brought back."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from streamlod.core.camera import look_at, pinhole
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer
from streamlod.core.train.field.exposure import Exposure, neutral
from streamlod.core.train.later_frame.colour_drift import followed, without_drift
from streamlod.core.train.pictures.views import Views
from tests.core.train.test_trainer import small_config
from tests.core.true_points import true_points

COUNT, HEIGHT, WIDTH = 4, 64, 96
ALL = list(range(COUNT))
CAMERAS = tuple(
    pinhole(f"cam{i}", (90.0, 90.0), (48.0, 32.0), (WIDTH, HEIGHT), look_at(np.array([i, -3.0, 1]), np.zeros(3), UP))
    for i, UP in enumerate([np.array([0.0, 0, 1])] * COUNT)
)
DRIFTED = Exposure(torch.tensor([[1.1, 1.08, 1.12]]).repeat(COUNT, 1), torch.full((COUNT, 3), 0.01))


def scene(seed: int = 0) -> Tensor:
    """[C,H,W,3] pictures of large patches of many colours, between 0.1 and 0.8."""
    generator = torch.Generator().manual_seed(seed)
    patches = 0.1 + 0.7 * torch.rand(COUNT, HEIGHT // 8, WIDTH // 8, 3, generator=generator)
    return patches.repeat_interleave(8, dim=1).repeat_interleave(8, dim=2)


def filmed(pictures: Tensor, seed: int = 1) -> Views:
    """`pictures` with a camera's noise, in grey levels."""
    noise = torch.randn(pictures.shape, generator=torch.Generator().manual_seed(seed)) / 255
    return Views(CAMERAS, ((pictures + noise).clamp(0, 1) * 255).round() / 255, ALL)


def drifted(pictures: Tensor, cameras: list[int]) -> Tensor:
    changed = pictures.clone()
    for number in cameras:
        changed[number] = DRIFTED.apply(pictures[number], number)
    return changed


def with_a_person(pictures: Tensor) -> Tensor:
    """Somebody who covers two fifths of every picture has come in."""
    covered = pictures.clone()
    covered[:, :, : 2 * WIDTH // 5] = scene(5)[:, :, : 2 * WIDTH // 5]
    return covered


@pytest.mark.parametrize("change", [lambda pictures: pictures, with_a_person], ids=["still", "a person"])
def test_a_camera_that_brightened_is_found_and_its_picture_brought_back(change: Callable[[Tensor], Tensor]) -> None:
    views, before = filmed(drifted(change(scene()), [2])), scene()
    drift = followed(neutral(COUNT), views, before, ALL)
    torch.testing.assert_close(drift.gain[2], DRIFTED.gain[2], atol=0.01, rtol=0)
    torch.testing.assert_close(drift.offset[2], DRIFTED.offset[2], atol=0.005, rtol=0)
    back = without_drift(views, drift, before)
    assert float((back.targets[2] - change(scene())[2]).abs().mean()) < 0.006
    for number in (0, 1, 3):
        assert torch.equal(back.targets[number], views.targets[number]), "cameras that did not drift keep every bit"


def test_it_is_followed_on_from_where_it_was() -> None:
    views = filmed(drifted(scene(), [2]))
    once = followed(neutral(COUNT), views, scene(), ALL)
    again = followed(once, views, scene(), ALL)
    torch.testing.assert_close(again.gain, once.gain, atol=2e-3, rtol=0)
    torch.testing.assert_close(again.offset, once.offset, atol=2e-3, rtol=0)
    back = followed(again, filmed(scene()), scene(), ALL)
    torch.testing.assert_close(back.gain, torch.ones(COUNT, 3), atol=5e-3, rtol=0)


def test_light_that_all_cameras_see_is_no_drift() -> None:
    views = filmed(drifted(scene(), ALL))
    assert without_drift(views, followed(neutral(COUNT), views, scene(), ALL), scene()) is views


@pytest.mark.parametrize(
    "views",
    [filmed(scene()), filmed(scene(7)), filmed(torch.zeros_like(scene())), filmed(torch.ones_like(scene()))],
    ids=["noise", "another scene", "black", "white"],
)
def test_pictures_that_tell_nothing_are_left_alone(views: Views) -> None:
    assert without_drift(views, followed(neutral(COUNT), views, scene(), ALL), scene()) is views


def test_what_is_clipped_is_as_it_was() -> None:
    before = scene()
    before[:, :16] = 0.97
    views = filmed(drifted(before, [2]))
    assert float(views.targets[2, :16].min()) == 1
    drift = followed(neutral(COUNT), views, before, ALL)
    assert torch.equal(without_drift(views, drift, before).targets[2, :16], before[2, :16])


def test_a_camera_that_is_not_known_is_not_judged() -> None:
    unknown = scene()
    unknown[2] = torch.nan
    views = filmed(drifted(scene(), [1, 2]))
    drift = followed(neutral(COUNT), views, unknown, [0, 1, 3])
    assert float(drift.gain[1].min()) > 1.05
    assert torch.equal(drift.gain[2], torch.ones(3))
    assert followed(drift, views, unknown, []) is drift
    assert bool(without_drift(views, drift, unknown).targets.isfinite().all())


@pytest.mark.parametrize(
    "count", [pytest.param(250, marks=pytest.mark.long), pytest.param(1000, marks=pytest.mark.slow)]
)
def test_exposures_end_where_they_began(count: int) -> None:
    drift, reference = neutral(COUNT), scene()
    for index in range(count):
        now = reference.clone()
        now[2] = now[2] * (1 + 0.2 * math.sin(2 * math.pi * index / 250))
        views = filmed(now, index)
        drift = followed(drift, views, reference, ALL)
        if index % 100 == 0:  # a keyframe makes the newest pictures the references
            reference = without_drift(views, drift, reference).targets
    end = followed(drift, filmed(reference, 1), reference, ALL)
    torch.testing.assert_close(end.gain, torch.ones(COUNT, 3), atol=0.02, rtol=0)


@pytest.mark.long
def test_a_still_scene_is_hardly_trained_for_drifting_cameras_and_players_are_told() -> None:
    spec = SyntheticSpec(cameras=5, frames=31, width=96, height=54, seed=1, still=True, exposure_drift=0.5)
    clip = open_synthetic(spec)
    frames = list(clip.frames())
    trainer = Trainer(clip.cameras, small_config(), clip.fps, "cpu", frame_budget_ms=1e6)  # keyframes are not trained
    first = trainer.keyframe(frames[0], true_points(spec)).scene
    trained = [trainer.predict(frame).report.dynamic for frame in frames[1:]]
    assert np.mean(trained) < 0.01 * first.anchor_count
    told, before = trainer.refresh(frames[-1]).scene.metadata.exposures, first.metadata.exposures
    brighter = [(frames[-1].images[i].mean() / frames[0].images[i].mean()) for i in range(5)]
    number = int(np.argmax(np.abs(np.log(brighter))))
    assert abs(brighter[number] - 1) > 0.05, "nothing drifts here"
    assert told is not None
    assert before is not None
    assert np.sign(np.mean(told[number].gain) - np.mean(before[number].gain)) == np.sign(brighter[number] - 1)
