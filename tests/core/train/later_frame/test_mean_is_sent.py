"""What a later frame sends is the mean over the last steps of its training."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from streamlod.core.camera import pinhole
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.convert import scene_of
from streamlod.core.train.optimise.adam import RowAdam
from streamlod.core.train.pictures.views import Views
from tests.core.train.fields import random_field
from tests.core.train.later_frame.begun import bare_state, training_of

WIDTH, HEIGHT = 40, 24


def _after_each_step(optimiser: RowAdam, monkeypatch: pytest.MonkeyPatch) -> list[Tensor]:
    """The latents after each step that `optimiser` will take."""
    latents, step = list[Tensor](), optimiser.step

    def remembering(rates: dict[str, float]) -> None:
        step(rates)
        latents.append(optimiser.parameters["latent"].detach().clone())

    monkeypatch.setattr(optimiser, "step", remembering)
    return latents


@pytest.mark.parametrize(("average_from", "last"), [(1.0, 1), (0.5, 4), (0.0, 8)])
def test_the_mean_of_the_last_steps_is_sent(average_from: float, last: int, monkeypatch: pytest.MonkeyPatch) -> None:
    config = PredictConfig(epochs=8, minimum_steps=0, most_effort=1.0, average_from=average_from)
    pose = np.eye(4)
    pose[2, 3] = 3.0
    camera = pinhole("cam00", (WIDTH, WIDTH), (WIDTH / 2, HEIGHT / 2), (WIDTH, HEIGHT), pose)
    state = bare_state(scene_of(random_field(60), config, (camera,), 30.0, 0))
    views = Views((camera,), torch.rand(1, HEIGHT, WIDTH, 3, generator=torch.Generator().manual_seed(0)), [0])
    masks = torch.ones(1, HEIGHT, WIDTH, dtype=torch.bool)
    everything = np.ones(len(state.field), np.bool_)
    trainer = training_of(state, everything, views, masks, config=config)
    latents = _after_each_step(trainer.anchors.optimiser, monkeypatch)
    update = trainer.run(torch.Generator().manual_seed(0))
    assert update.steps == len(latents) == 8
    assert not torch.equal(latents[-1], latents[-2])
    mean = torch.stack(latents[-last:]).mean(dim=0).numpy()
    settled = trainer.anchors.optimiser.parameters["latent"].detach().numpy()
    np.testing.assert_allclose(settled, mean, atol=1e-4)
