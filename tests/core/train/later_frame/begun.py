"""A frame's training that is about to begin, for tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool
from streamlod.core.render.backends import Backend
from streamlod.core.train.field.exposure import neutral
from streamlod.core.train.later_frame.comparison import Comparison
from streamlod.core.train.later_frame.frame import started
from streamlod.core.train.later_frame.part import Beginning, FramePart
from streamlod.core.train.later_frame.state import State
from streamlod.core.train.later_frame.training import FrameTraining
from streamlod.core.train.pictures.views import Views
from streamlod.core.train.progress import Stopwatch

PLENTY = 1 << 20


def beginning_of(
    state: State, trained: Bool, views: Views, masks: Tensor, *, max_new: int = PLENTY, bit_price: float = 0.0
) -> Beginning:
    """What is known before the anchors `trained` [N] are."""
    rows = torch.from_numpy(np.flatnonzero(trained))
    base, count = state.field.with_rows(rows), state.scene.anchor_count
    references, filmed = (views.targets if seen is None else seen for seen in (state.references, state.filmed))
    pictures = Comparison(views, masks, references, filmed, state.shown)
    cell = state.field.octree.motion_cell
    return Beginning(state, rows, base, pictures, pictures, cell, bit_price, PLENTY, count, max_new)


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
) -> FrameTraining:
    """Training of the anchors `trained` [N], by all usable cameras."""
    seen = beginning_of(state, trained, views, masks, max_new=max_new, bit_price=bit_price)
    hooks = started(parts, seen, lambda stage: True, Stopwatch())
    return FrameTraining(seen, hooks, neutral(len(views.cameras)), list(views.usable), backend)
