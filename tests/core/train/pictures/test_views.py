"""Pictures of an instant at which not all cameras are there."""

from __future__ import annotations

import numpy as np
import torch

from streamlod.core.camera import look_at, pinhole
from streamlod.core.train.pictures.views import Views

POSE = look_at(np.array([0.0, 0, -3]), np.zeros(3), np.array([0.0, -1, 0]))
CAMERAS = tuple(pinhole(f"cam{number}", (8, 8), (4, 3), (8, 6), POSE) for number in range(3))


def test_a_camera_that_is_away_keeps_its_last_picture() -> None:
    before, now = torch.full((3, 6, 8, 3), 0.2), torch.full((3, 6, 8, 3), 0.7)
    latest = Views(CAMERAS, now, [0, 2]).or_before(before)
    assert (latest[[0, 2]] == 0.7).all()
    assert (latest[1] == 0.2).all()
    assert (before == 0.2).all()
    assert torch.equal(Views(CAMERAS, now, [0, 1, 2]).or_before(before), now)
