"""Steps of a later frame by how much of its pictures changed."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from streamlod.core.train import preset
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.later_frame.steps import most_steps, steps_of

CONFIG = PredictConfig(epochs=10, minimum_steps=40, most_effort=2.0)


def masks(cameras: int, share: float) -> torch.Tensor:
    """[C,20,50] of which this share changed."""
    changed = torch.zeros(cameras, 20, 50, dtype=torch.bool)
    changed[:, :, : round(50 * share)] = True
    return changed


def test_what_little_changes_takes_the_usual_steps() -> None:
    assert steps_of(CONFIG, masks(6, 0.0)) == steps_of(CONFIG, masks(6, 0.18)) == 60
    assert steps_of(CONFIG, masks(2, 0.0)) == 40
    assert steps_of(CONFIG, masks(0, 0.0)) == 40


def test_more_steps_where_more_changed_and_never_more_than_the_most() -> None:
    steps = [steps_of(CONFIG, masks(6, share)) for share in (0.22, 0.24, 0.26, 0.3, 1.0)]
    assert steps == sorted(steps)
    assert 60 < steps[0] < steps[2] < steps[3] == steps[4] == 120


@pytest.mark.parametrize("effort", [0.0, 0.5, 1.0])
def test_no_effort_means_the_configured_steps(effort: float) -> None:
    assert steps_of(replace(CONFIG, most_effort=effort), masks(6, 1.0)) == 60


@pytest.mark.parametrize("share", [0.1, 1.0])
def test_the_paper_has_its_epochs_whatever_changed(share: float) -> None:
    assert steps_of(preset("paper").predict, masks(3, share)) == 30


@pytest.mark.parametrize("effort", [0.0, 1.0, 2.0, 3.5])
@pytest.mark.parametrize("cameras", [2, 6])
def test_no_frame_takes_more_than_the_most(cameras: int, effort: float) -> None:
    config = replace(CONFIG, most_effort=effort)
    assert most_steps(config, cameras) == steps_of(config, masks(cameras, 1.0))
