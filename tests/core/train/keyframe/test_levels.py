"""Levels chosen by distance in later frames, and what anchors show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.camera import look_at, pinhole
from streamlod.core.train.field.field import Field, visible_levels
from streamlod.core.train.field.rendered import rendered
from streamlod.core.train.pictures.views import Views
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


def test_a_camera_without_a_picture_is_shown_nothing_known(field: Field) -> None:
    views = Views((CAMERA, CAMERA), torch.zeros(2, CAMERA.height, CAMERA.width, 3), usable=[1])
    pictures = rendered(field, torch.ones(len(field), dtype=torch.bool), views, "cpu")
    assert pictures[0].isnan().all()
    assert not pictures[1].isnan().any()
    assert pictures[1].max() > 0
