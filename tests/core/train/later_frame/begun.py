"""A frame's training that is about to begin, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool
from streamlod.core.render.backends import Backend
from streamlod.core.scene.anchors import Scene
from streamlod.core.train.config import ModelConfig, PredictConfig, TrainConfig
from streamlod.core.train.field.exposure import neutral
from streamlod.core.train.later_frame.autograd.engine import autograd_engine
from streamlod.core.train.later_frame.comparison import Beginning, Comparison
from streamlod.core.train.later_frame.engine import EngineMaker
from streamlod.core.train.later_frame.frame import started
from streamlod.core.train.later_frame.part import FramePart
from streamlod.core.train.later_frame.state import KnownPictures, State, fresh_state
from streamlod.core.train.later_frame.training import FrameTraining
from streamlod.core.train.pictures.views import Views
from streamlod.core.train.progress import Stopwatch

PLENTY = 1 << 20
USUAL = PredictConfig()


def bare_state(scene: Scene) -> State:
    """The state of a keyframe, without any pictures."""
    nothing = torch.empty(0)
    return fresh_state(scene, "cpu", KnownPictures(nothing, nothing, nothing))


def beginning_of(
    state: State, trained: Bool, views: Views, masks: Tensor, *, max_new: int = PLENTY, bit_price: float = 0.0
) -> Beginning:
    """What is known before the anchors `trained` [N] are; of the pictures before, only that they were like these."""
    rows = torch.from_numpy(np.flatnonzero(trained))
    config = TrainConfig(ModelConfig(max_anchors=PLENTY), predict=PredictConfig(rate_weight=bit_price))
    known = KnownPictures(views.targets, views.targets, torch.full_like(views.targets, torch.nan))
    state, pictures = replace(state, known=known), Comparison(views, masks, known)
    return Beginning(state, rows, pictures, pictures, config, state.scene.anchor_count, max_new)


def training_of(
    state: State,
    trained: Bool,
    views: Views,
    masks: Tensor,
    parts: Sequence[FramePart] = (),
    *,
    max_new: int = PLENTY,
    bit_price: float = 0.0,
    backend: Backend = "cpu",
    engine_of: EngineMaker | None = None,
    config: PredictConfig = USUAL,
) -> FrameTraining:
    """Training of the anchors `trained` [N], by all usable cameras."""
    seen = beginning_of(state, trained, views, masks, max_new=max_new, bit_price=bit_price)
    hooks = started(parts, seen, lambda stage: True, Stopwatch())
    return FrameTraining(
        seen, hooks, neutral(len(views.cameras)), list(views.usable), engine_of or autograd_engine(backend), config
    )
