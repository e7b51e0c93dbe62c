"""The anchors in training: what is sent is the mean of the steps that were counted."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from streamlod.core.camera import pinhole
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.convert import scene_of
from streamlod.core.train.later_frame.anchors import TrainedAnchors
from streamlod.core.train.later_frame.state import State
from tests.core.train.fields import random_field
from tests.core.train.later_frame.begun import bare_state

NUMBERS = ("level", "voxel", "extra_level", "position", "feature", "offset", "scaling")  # of a new anchor


@pytest.fixture
def state() -> State:
    camera = pinhole("cam00", (40, 40), (20, 12), (40, 24), np.eye(4))
    return bare_state(scene_of(random_field(30), PredictConfig(), (camera,), 30.0, 0))


@pytest.fixture
def anchors(state: State) -> TrainedAnchors:
    return TrainedAnchors(state, torch.arange(0, 30, 2), torch.ones(15, 1), 0.9)


def sent(anchors: TrainedAnchors) -> tuple[int, int]:
    """The first latent and the first position that go to the decoder."""
    update = anchors.update(np.ones(len(anchors.field()), np.bool_), 1, 0.0)
    return int(update.latent[0, 0]), int(update.position[0, 0])


def put(anchors: TrainedAnchors, latent: float, position: float) -> None:
    with torch.no_grad():
        anchors.optimiser.parameters["latent"].fill_(latent)
        anchors.optimiser.parameters["position"].fill_(position)


def test_the_mean_of_counted_steps_is_sent(anchors: TrainedAnchors) -> None:
    for latent, position in ((4.0, 10.0), (8.0, 20.0)):
        put(anchors, latent, position)
        anchors.optimiser.average()
    put(anchors, -50.0, -50.0)
    anchors.settle()
    assert sent(anchors) == (6, 15)


def test_the_last_step_is_sent_where_none_was_counted(anchors: TrainedAnchors) -> None:
    put(anchors, 3.0, 7.0)
    anchors.settle()
    assert sent(anchors) == (3, 7)


def test_steps_before_anchors_joined_do_not_count(state: State, anchors: TrainedAnchors) -> None:
    put(anchors, 100.0, 100.0)
    anchors.optimiser.average()
    new = {name: getattr(state.field, name)[1:3] for name in NUMBERS}
    anchors.add(new)
    put(anchors, 5.0, 9.0)
    anchors.optimiser.average()
    anchors.settle()
    assert sent(anchors) == (5, 9)


def test_what_was_trained_elsewhere_is_sent(anchors: TrainedAnchors) -> None:
    anchors.adopt(torch.full((15, 24), 3.0), torch.full((15, 3), -2.0), torch.zeros(0, 0), 4)
    assert sent(anchors) == (3, -2)
    assert anchors.update(np.ones(15, np.bool_), 1, 0.0).repaired == 4
