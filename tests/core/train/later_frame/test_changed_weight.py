"""Later frames mend what has changed before what has not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from streamlod.core.camera import look_at, pinhole
from streamlod.core.train import PredictConfig
from streamlod.core.train.field.rendered import rendered
from streamlod.core.train.pictures.views import Views
from tests.client.web.scenes import make_scene
from tests.core.train.later_frame.begun import bare_state, training_of

CONFIG = PredictConfig(epochs=20, minimum_steps=0, rate_weight=0.0)
POSE = look_at(np.array([0.0, -0.9, -3.2]), np.zeros(3), np.array([0.0, -1.0, 0.0]))
# two cameras at one place, which film different things
CAMERAS = tuple(pinhole(name, (64.0, 64.0), (32.0, 24.0), (64, 48), POSE) for name in ("changed", "unchanged"))


def errors(changed_weight: float) -> list[float]:
    """Mean absolute error of each camera, where anchors are, after a frame that changed the first one's pixels only."""
    state = bare_state(make_scene(400, view_dependent=False))
    views = Views(CAMERAS, torch.zeros(2, 48, 64, 3), [0, 1])
    filmed = rendered(state.field, state.alive, views, "cpu")
    views = replace(views, targets=torch.stack([(filmed[0] + 0.15).clamp(max=1), (filmed[1] - 0.15).clamp(min=0)]))
    masks = torch.stack([torch.ones(48, 64, dtype=torch.bool), torch.zeros(48, 64, dtype=torch.bool)])
    everything = np.ones(len(state.field), np.bool_)
    config = replace(CONFIG, changed_weight=changed_weight)
    trainer = training_of(state, everything, views, masks, config=config)
    trainer.run(torch.Generator().manual_seed(0))
    shown = trainer.show(trainer.anchors.field(), torch.arange(len(state.field)))
    there = filmed[0].amax(dim=2) > 0.3
    return [float((one - other)[there].abs().mean()) for one, other in zip(shown, views.targets, strict=True)]


def test_changed_pixels_are_mended_first() -> None:
    alike, weighted = errors(0.0), errors(4.0)
    assert alike[0] > 0.8 * alike[1]
    assert weighted[0] < 0.7 * alike[0]
    assert weighted[1] > alike[1]
