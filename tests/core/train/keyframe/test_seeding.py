"""First anchors: how fine they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.arrays import Float64
from streamlod.core.camera import look_at, pinhole
from streamlod.core.frames import PointCloud
from streamlod.core.train import preset
from streamlod.core.train.keyframe.seeding import seed_field

CAMERAS = tuple(
    pinhole(
        f"{x}", (400, 400), (256, 144), (512, 288), look_at(np.array([x, 0.0, -4.0]), np.zeros(3), np.array([0, -1, 0]))
    )
    for x in (-1.0, 0.0, 1.0)
)


def widths(first_cell_pixels: float, points: int = 60_000) -> Float64:
    """Width in pixels of each first anchor's cell as its nearest camera sees it, of points close together."""
    where = np.random.default_rng(0).uniform((-2, -1, -1), (2, 1, 6), (points, 3)).astype(np.float32)
    model = replace(preset("live").model, first_cell_pixels=first_cell_pixels, max_anchors=200_000)
    field = seed_field(PointCloud(where, np.full_like(where, 0.5)), CAMERAS, model, torch.Generator().manual_seed(0))
    position = field.position.double().numpy()
    distance = np.min([np.linalg.norm(position - camera.centre, axis=1) for camera in CAMERAS], axis=0)
    cell = field.octree.root_cell / 2.0 ** field.level.double().numpy()
    return np.asarray(400 * cell / distance)


@pytest.mark.long
def test_first_anchors_are_no_finer_than_their_least_width() -> None:
    whole_levels = np.sqrt(2)  # widths halve from level to level: the nearest level is taken
    assert 8 / whole_levels * 0.999 <= widths(8.0).min() < 8 * whole_levels
    assert widths(0.0).min() < 4


def test_few_points_fill_cells_of_every_level() -> None:
    np.testing.assert_array_equal(widths(8.0, points=500), widths(0.0, points=500))
