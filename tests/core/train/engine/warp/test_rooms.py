"""Memory of training steps: as much as a frame needs, and no frame suffers from what the one before needed."""

from __future__ import annotations

import logging

import numpy as np
import pytest
import torch

from streamlod.core.camera import pinhole
from streamlod.core.errors import ModelError
from streamlod.core.render.cpu.listing import MAX_PAIRS
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.engine.warp.frame_engine import WarpEngine
from streamlod.core.train.engine.warp.rooms import StepRooms
from streamlod.core.train.field.convert import scene_of
from streamlod.core.train.later_frame.training import FrameTraining
from streamlod.core.train.later_frame.update import IntegerUpdate
from streamlod.core.train.pictures.views import Views
from tests.core.train.fields import random_field
from tests.core.train.later_frame.begun import bare_state, training_of

pytestmark = pytest.mark.long  # compiling the kernels takes a minute

SIZE = 96, 54
WILD = 0.4  # learning rate at which anchors that are shown noise grow over the whole picture


def training(rooms: StepRooms, anchors: int, rate: float) -> FrameTraining:
    """Every third of so many anchors before one camera, which films noise."""
    pose = np.eye(4)
    pose[2, 3] = 3.0
    camera = pinhole("cam00", (90.0, 90.0), (48.0, 27.0), SIZE, pose)
    config = PredictConfig(minimum_steps=20, average_from=1.0, latent_rate=rate, position_rate=rate)
    state = bare_state(scene_of(random_field(anchors), config, (camera,), 30.0, 0))
    views = Views((camera,), torch.rand(1, *SIZE[::-1], 3, generator=torch.Generator().manual_seed(1)), [0])
    masks = torch.ones(1, *SIZE[::-1], dtype=torch.bool)
    some = np.arange(anchors) % 3 == 0
    return training_of(state, some, views, masks, config=config, engine_of=lambda task: WarpEngine(task, rooms))


def run(rooms: StepRooms, anchors: int, rate: float = 0.1) -> IntegerUpdate:
    return training(rooms, anchors, rate).run(torch.Generator().manual_seed(0))


def test_little_memory_trains_what_much_trains() -> None:
    much, little = run(StepRooms("cpu"), 60), run(StepRooms("cpu", 4.0, is_small=True), 60)
    assert much.latent.any()
    assert np.array_equal(much.latent, little.latent)
    assert np.array_equal(much.position, little.position)


def test_memory_is_kept_and_grows() -> None:
    rooms, steps = StepRooms("cpu", 4.0, is_small=True), []
    for anchors in (60, 57, 500, 60):
        found, fresh = run(rooms, anchors), run(StepRooms("cpu"), anchors)
        assert np.array_equal(found.latent, fresh.latent)
        steps.append(rooms.whole)
    assert steps[0] is steps[1] is not steps[2] is steps[3]


def test_tiles_that_lack_gaussians_are_told_and_lose_nothing(caplog: pytest.LogCaptureFixture) -> None:
    rooms = StepRooms("cpu", 1.0, is_small=True)
    with caplog.at_level(logging.WARNING):
        update = run(rooms, 60, WILD)
    assert "had no room" in caplog.text
    assert update.repaired == 0
    assert update.latent.any()
    assert rooms.overflow > 0
    run(rooms, 60, WILD)  # has more from the start
    assert rooms.overflow == 0


def test_more_pairs_than_memory_holds_are_refused() -> None:
    rooms = StepRooms("cpu")
    run(rooms, 60)
    assert rooms.whole is not None
    rooms.whole.room.still.most.fill_(MAX_PAIRS + 1)
    with pytest.raises(ModelError, match="scales are out of hand"):
        rooms.counted(rooms.whole.room.capacity)
