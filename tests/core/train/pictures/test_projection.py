"""Places in pictures by torch against the same by NumPy."""

from __future__ import annotations

import numpy as np
import torch

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.initialise.views import inside, project
from streamlod.core.train.pictures.projection import projected

POSE = look_at(np.array([0.3, -2.0, 0.4]), np.zeros(3), np.array([0.0, 0.0, 1.0]))


def camera() -> Camera:
    return pinhole("c", (50.0, 60.0), (33.0, 22.0), (64, 48), POSE)


def test_places_lie_where_numpy_says() -> None:
    """On every side of the picture and of the camera."""
    places = torch.randn(4000, 3, generator=torch.Generator().manual_seed(0)) * 2
    column, row, depth, seen = projected(places, camera())
    pixels, depths = project(camera(), places.double().numpy())
    expected = inside(camera(), pixels, depths)
    assert 100 < expected.sum() < 3900
    assert seen.numpy().tolist() == expected.tolist()
    np.testing.assert_allclose(depth.numpy(), depths, atol=1e-5)
    np.testing.assert_allclose(torch.stack([column, row], dim=1).numpy()[expected], pixels[expected], atol=1e-3)


def test_what_is_in_the_lens_or_nowhere_is_not_in_view() -> None:
    centre = torch.from_numpy(camera().centre).float()
    behind = centre - torch.from_numpy(POSE[2, :3]).float()
    places = torch.stack([centre, behind, torch.full((3,), torch.nan)])
    assert projected(places, camera())[3].tolist() == [False, False, False]
