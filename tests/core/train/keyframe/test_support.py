"""Places by the cameras that see them, and what follows for dropout and prices."""

from __future__ import annotations

import numpy as np
import torch

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.initialise.views import inside, project
from streamlod.core.train.config import KeyframeConfig
from streamlod.core.train.keyframe.support import price_share, support
from streamlod.core.train.optimise.schedule import dropout_keep

UP = np.array([0.0, -1.0, 0.0])


def camera(x: float, ahead: float) -> Camera:
    eye = np.array([x, 0.0, -4.0])
    return pinhole(f"{x}", (40, 40), (24, 16), (48, 32), look_at(eye, np.array([ahead, 0.0, 0.0]), UP))


CAMERAS = camera(-1, -1), camera(0, 0), camera(2, 4)


def test_support_is_the_share_of_the_other_cameras_that_have_the_place_in_their_pictures() -> None:
    points = np.random.default_rng(0).uniform(-6, 6, (500, 3)).astype(np.float32)
    seen = np.sum([inside(c, *project(c, points.astype(np.float64))) for c in CAMERAS], axis=0)
    found = support(torch.from_numpy(points), CAMERAS).numpy()
    np.testing.assert_allclose(found, np.clip((seen - 1) / 2, 0, 1))
    assert set(found) == {0.0, 0.5, 1.0}
    assert (support(torch.from_numpy(points), CAMERAS[:1]) == 0).all()


def test_what_one_camera_sees_is_never_left_out_and_pays_a_quarter() -> None:
    config = KeyframeConfig(dropout_base=0.4, dropout_slope=0.0)
    shares = torch.tensor([0.0, 0.5, 1.0]).repeat_interleave(20_000)
    kept = dropout_keep(torch.zeros(60_000, dtype=torch.long), 1, config, 1.0, torch.Generator().manual_seed(0), shares)
    for part, rate in zip(kept.reshape(3, -1), (0.0, 0.2, 0.4), strict=True):
        assert abs(float((part == 0).float().mean()) - rate) < 0.01
        assert abs(float(part.mean()) - 1) < 0.02
    assert price_share(torch.tensor([0.0, 1.0])).tolist() == [0.25, 1.0]
