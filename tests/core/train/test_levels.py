"""Levels chosen by distance in later frames, and what anchors show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from core.camera import look_at, pinhole
from core.train.coverage import coverage
from core.train.exposure import fitted, neutral
from core.train.field import Field, visible_levels
from core.train.partition import tiles_of
from tests.core.train.fields import random_field

POSE = look_at(np.array([0.0, -3.0, 0.5]), np.zeros(3), np.array([0.0, 0.0, 1.0]))
CAMERA = pinhole("c", (60.0, 60.0), (32.0, 24.0), (64, 48), POSE)


@pytest.fixture
def field() -> Field:
    return random_field(120)


def test_levels_that_the_distance_does_not_call_for_are_transparent(field: Field) -> None:
    centre = torch.from_numpy(CAMERA.centre).float()
    everything, chosen = field.decode(centre), replace(field, by_distance=True).decode(centre)
    drawn = visible_levels(field, centre, field.octree.levels - 1).repeat_interleave(field.slots)
    torch.testing.assert_close(chosen.opacities[drawn], everything.opacities[drawn])
    assert (chosen.opacities[~drawn] == 0).all()
    assert field.looks_the_same
    assert not replace(field, by_distance=True).looks_the_same


def test_areas_shown_add_up_to_what_is_opaque(field: Field) -> None:
    rows = torch.arange(len(field))
    maps = torch.zeros(CAMERA.height, CAMERA.width, 2)
    maps[..., 0] = 1
    maps[:, :32, 1] = 1
    shown = coverage(field, rows, rows[:0], CAMERA, maps, "cpu")
    assert shown.shape == (len(field), 2)
    assert (shown >= -1e-4).all()
    assert (shown[:, 1] <= shown[:, 0] + 1e-4).all()
    assert 0 < shown[:, 0].sum() <= CAMERA.width * CAMERA.height + 1
    half = len(field) // 2
    asked = coverage(field, rows[:half], rows[half:], CAMERA, maps, "cpu")
    torch.testing.assert_close(asked, shown[:half], atol=1e-3, rtol=1e-3)


def test_tiles_hold_every_pixel_of_a_mask() -> None:
    mask = torch.zeros(40, 50, dtype=torch.bool)
    mask[39, 49] = mask[0, 17] = True
    tiles = tiles_of(mask)
    assert tiles.shape == (3, 4)
    assert tiles.nonzero().tolist() == [[0, 1], [2, 3]]
    assert tiles_of(mask, room=1).sum() == 6 + 4 - 1


def test_exposures_are_found_again_from_pictures() -> None:
    shown = torch.rand(2, 20, 30, 3, generator=torch.Generator().manual_seed(0))
    truth = neutral(2)
    truth.gain[0] = torch.tensor([0.8, 1.1, 1.3])
    truth.offset[0] = torch.tensor([0.05, -0.02, 0.0])
    targets = torch.stack([truth.apply(shown[0], 0), shown[1]])
    found = fitted(shown, targets, [0])
    torch.testing.assert_close(found.gain, truth.gain, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(found.offset, truth.offset, atol=1e-4, rtol=1e-4)
    flat = fitted(torch.full((1, 4, 4, 3), 0.5), torch.full((1, 4, 4, 3), 0.7), [0])
    assert (flat.gain == 1).all()
    torch.testing.assert_close(flat.offset, torch.full((1, 3), 0.2))
