"""Only anchors that mostly show what changed are trained, and only tiles that they reach are drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.camera import pinhole
from streamlod.core.frames import FrameSet
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import PredictConfig, Trainer, preset
from streamlod.core.train.field.convert import scene_of
from streamlod.core.train.later_frame.active_tiles import mostly_active
from streamlod.core.train.later_frame.state import State
from tests.core.train.fields import random_field
from tests.core.train.later_frame.begun import bare_state
from tests.core.true_points import true_points

WIDTH, HEIGHT = 96, 64
POSE = np.eye(4)
POSE[2, 3] = 3.0
CAMERA = pinhole("cam00", (WIDTH, WIDTH), (WIDTH / 2, HEIGHT / 2), (WIDTH, HEIGHT), POSE)
ROWS = torch.arange(60)


@pytest.fixture
def state() -> State:
    """Small anchors, and every tenth as wide as the scene."""
    small = bare_state(scene_of(random_field(60), PredictConfig(), (CAMERA,), 30.0, 0))
    scaling, offset = small.field.scaling.clone() - 3.0, small.field.offset.clone()
    scaling[::10], offset[::10] = 0.0, 0.0
    network = replace(small.field.network, output_bias=small.field.network.output_bias.clone())
    network.output_bias[: small.field.slots] = 1.0  # all can be seen
    return replace(small, field=replace(small.field, scaling=scaling, offset=offset, network=network))


def changed(share: float) -> np.ndarray:
    """[4,6] bool: the tiles on the left up to this share of the picture."""
    tiles = np.zeros((4, 6), np.bool_)
    tiles[:, : round(share * 6)] = True
    return tiles


def test_wide_anchors_are_trained_only_where_most_of_the_picture_changed(state: State) -> None:
    some, whole = (mostly_active(state.field, ROWS, (CAMERA,), {0: changed(share)}) for share in (0.3, 1.0))
    assert not some[::10].any()
    assert 0.2 < some.mean() < 0.6  # small ones on the left
    assert whole[::10].any()
    assert not (some & ~whole).any()


def test_where_nothing_changed_nothing_is_trained(state: State) -> None:
    assert not mostly_active(state.field, ROWS, (CAMERA,), {0: changed(0.0)}).any()
    assert not mostly_active(state.field, ROWS, (CAMERA,), {}).any()
    assert mostly_active(state.field, ROWS[:0], (CAMERA,), {0: changed(0.5)}).shape == (0,)


def test_a_camera_in_which_an_anchor_reaches_nothing_that_changed_is_not_asked(state: State) -> None:
    one = mostly_active(state.field, ROWS, (CAMERA,), {0: changed(0.5)})
    both = mostly_active(state.field, ROWS, (CAMERA, CAMERA), {0: changed(0.5), 1: changed(0.0)})
    np.testing.assert_array_equal(one, both)


@pytest.mark.long
def test_a_camera_whose_picture_did_not_change_is_not_drawn() -> None:
    spec = SyntheticSpec(cameras=4, frames=3, width=96, height=56, seed=1)
    clip, live = open_synthetic(spec), preset("live")
    before, _, moved = clip.frames()
    images = moved.images.copy()
    images[1] = before.images[1]  # this camera sees nothing of what moves
    frame = FrameSet(1, moved.time_ns, images, moved.present)
    predict = replace(live.predict, epochs=1, minimum_steps=6)
    config = replace(live, keyframe=replace(live.keyframe, steps=20), predict=predict)
    trainer = Trainer(clip.cameras, config, clip.fps, "cpu")
    trainer.resume(trainer.keyframe(before, true_points(spec)).scene)
    trainer.predict(before)  # the pictures of the state are known from here on
    known = trainer._require().known.shown
    result = trainer.predict(frame)
    assert result.residual is not None
    assert result.residual.changed > 0
    shown = trainer._require().known.shown
    assert torch.equal(shown[1], known[1])
    for number in (0, 2, 3):
        assert not torch.equal(shown[number], known[number])
