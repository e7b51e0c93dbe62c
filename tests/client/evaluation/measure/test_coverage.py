"""Areas that anchors show."""

from __future__ import annotations

import numpy as np
import torch

from streamlod.client.evaluation.measure.coverage import coverage
from streamlod.core.camera import look_at, pinhole
from tests.core.train.fields import random_field

POSE = look_at(np.array([0.0, -3.0, 0.5]), np.zeros(3), np.array([0.0, 0.0, 1.0]))
CAMERA = pinhole("c", (60.0, 60.0), (32.0, 24.0), (64, 48), POSE)


def test_areas_shown_add_up_to_what_is_opaque() -> None:
    field = random_field(120)
    rows = torch.arange(len(field))
    maps = torch.zeros(CAMERA.height, CAMERA.width, 2)
    maps[..., 0] = 1
    maps[:, :32, 1] = 1
    shown = coverage(field, rows, CAMERA, maps)
    assert shown.shape == (len(field), 2)
    assert (shown >= -1e-4).all()
    assert (shown[:, 1] <= shown[:, 0] + 1e-4).all()
    assert 0 < shown[:, 0].sum() <= CAMERA.width * CAMERA.height + 1
