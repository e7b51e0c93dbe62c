"""Which anchors were trained is known when anchors are added and rows are numbered anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from streamlod.core.camera import pinhole
from streamlod.core.scene.residual import apply
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.convert import level_starts, levels_of, scene_of
from streamlod.core.train.later_frame.update import no_update, residual_of
from tests.core.train.fields import random_field
from tests.core.train.later_frame.begun import bare_state


def test_added_anchors_count_as_trained_and_move_the_rows_of_others() -> None:
    camera = pinhole("cam00", (40.0, 40.0), (20.0, 12.0), (40, 24), np.eye(4))
    scene = scene_of(random_field(30), PredictConfig(), (camera,), 30.0, 0)
    state = bare_state(scene)
    rows = torch.tensor([2, 12, 25])  # one of each level
    assert np.searchsorted(level_starts(scene), rows.numpy(), side="right").tolist() == [1, 2, 3]
    new = state.field.with_rows(torch.tensor([0, 15]))
    added = levels_of(new, np.zeros((2, 3), np.int32), scene.header)
    position = np.array([[1, 0, 0], [0, 2, 0], [0, 0, 3]], np.int32)
    update = replace(no_update(3), position=position, added=added)
    residual = residual_of(scene, rows.numpy(), update, 1)
    partition = np.isin(np.arange(30), rows)
    after = state.after(residual, apply(scene, residual), partition)

    assert len(after.field) == 32
    starts = level_starts(after.scene)
    added = [starts[1] - 1, starts[2] - 1]  # one at the end of each level of its own
    assert np.flatnonzero(after.trained).tolist() == sorted([2, 13, 27, *added])  # one row more, two more
