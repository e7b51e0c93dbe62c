"""Views on the way from a camera to its neighbour."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.core.camera.beside import between, views_beside
from streamlod.core.synthetic import SyntheticSpec, cameras

SPEC = SyntheticSpec(cameras=4, frames=2, width=64, height=36, noise=0.0)


def test_a_view_at_either_end_is_the_camera_itself() -> None:
    first, second = cameras(SPEC)[1:3]
    for share, camera in ((0.0, first), (1.0, second)):
        np.testing.assert_allclose(between(first, second, share).world_to_camera, camera.world_to_camera, atol=1e-9)
    middle = between(first, second, 0.5)
    np.testing.assert_allclose(middle.centre, (first.centre + second.centre) / 2)


def test_views_lie_towards_the_nearest_camera_and_a_middle_comes_once() -> None:
    rig = cameras(SPEC)  # cam00 in the middle of an arc of three
    near = views_beside(rig, 0.1)
    assert len(near) == 4
    for camera, view in zip(rig, near, strict=True):
        closest = min(float(np.linalg.norm(camera.centre - other.centre)) for other in rig if other is not camera)
        assert np.linalg.norm(view.centre - camera.centre) == pytest.approx(0.1 * closest)
    middles = [tuple(view.centre.round(6)) for view in views_beside(rig, 0.5)]
    assert len(middles) == len(set(middles)) < 4
