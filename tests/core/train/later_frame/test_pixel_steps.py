"""Positions are trained in pixels of the camera that shows an anchor largest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.camera import Camera, pinhole
from streamlod.core.train.later_frame.pixel_steps import _UNSEEN, steps_a_pixel
from tests.core.train.fields import random_field

FOCAL = 100.0


def camera_at(z: float) -> Camera:
    """Looks along the z-axis from there; 40 x 24 pixels."""
    pose = np.eye(4)
    pose[2, 3] = -z
    return pinhole(f"at{z}", (FOCAL, FOCAL), (20, 12), (40, 24), pose)


@pytest.mark.parametrize(("cameras", "depth"), [((0.0,), 4.0), ((-2.0, 0.0, -4.0), 4.0), ((0.0, 3.0), 1.0)])
def test_a_pixel_is_what_the_nearest_camera_sees_of_it(cameras: tuple[float, ...], depth: float) -> None:
    field = replace(random_field(2), position=torch.tensor([[0.0, 0.0, 4.0], [0.001, 0.0, 4.0]]))
    widths = np.full(field.octree.levels, 0.02, np.float32)
    found = steps_a_pixel(field, widths, [camera_at(z) for z in cameras])
    assert found.shape == (2, 1)
    torch.testing.assert_close(found, torch.full((2, 1), depth / FOCAL / 0.02))


def test_each_level_has_steps_of_its_own() -> None:
    field = random_field(40)
    field = replace(field, position=torch.tensor([0.0, 0.0, 2.0]).repeat(40, 1))
    widths = 0.01 * 2.0 ** -np.arange(field.octree.levels, dtype=np.float32)
    found = steps_a_pixel(field, widths, [camera_at(0.0)])[:, 0]
    torch.testing.assert_close(found, 2.0 * 2.0**field.level)


def test_what_no_camera_shows_has_a_usual_pixel() -> None:
    places = torch.tensor([[0.0, 0.0, -1.0], [5.0, 0.0, 1.0], [0.0, 0.0, 0.0]])  # behind, beside, in the lens
    field = replace(random_field(3), position=places)
    found = steps_a_pixel(field, np.full(field.octree.levels, 0.02, np.float32), [camera_at(0.0)])
    torch.testing.assert_close(found, torch.full((3, 1), _UNSEEN))
