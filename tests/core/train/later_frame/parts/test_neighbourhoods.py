"""Groups: neighbourhoods are found, shifted and turned as one, and find motion that single anchors do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.camera import look_at, pinhole
from streamlod.core.scene.octree import Octree
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.convert import scene_of
from streamlod.core.train.field.field import Field
from streamlod.core.train.field.rendered import rendered
from streamlod.core.train.later_frame.parts.neighbourhoods import Neighbourhoods, neighbourhoods
from streamlod.core.train.later_frame.state import fresh_state
from streamlod.core.train.pictures.views import Views
from tests.core.train.fields import random_field
from tests.core.train.later_frame.begun import training_of

WIDTH, HEIGHT = 96, 64


def test_a_group_is_what_lies_in_one_cell() -> None:
    position = torch.tensor([[0.1, 0.1, 0.1], [0.9, 0.2, 0.4], [1.1, 0.1, 0.1], [-0.1, 0.1, 0.1]])
    groups = neighbourhoods(position, 1.0)
    assert groups.count == 3
    assert groups.number[0] == groups.number[1]
    assert len(set(groups.number[[0, 2, 3]].tolist())) == 3
    torch.testing.assert_close(groups.arm[0] + groups.arm[1], torch.zeros(3))
    torch.testing.assert_close(groups.arm[2:], torch.zeros(2, 3))


def test_a_turn_is_a_small_rotation_about_the_groups_middle() -> None:
    position = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) * 4
    groups = neighbourhoods(position, 4.0)
    axis = torch.tensor([[0.3, -0.5, 0.8]])
    angle = 1e-3 * axis
    rotation = torch.linalg.matrix_exp(torch.linalg.cross(angle.expand(3, 3), torch.eye(3)))
    centre = position.mean(dim=0)
    turned = centre + (position - centre) @ rotation - position
    own = torch.rand(50, 3)
    moved = groups.moved(torch.zeros(50, 3), torch.zeros(1, 3), 1e-3 * 4.0 * axis)
    torch.testing.assert_close(moved, turned, atol=1e-5, rtol=0)
    torch.testing.assert_close(groups.moved(own, axis, torch.zeros(1, 3)), own + axis)


def test_gradients_are_those_of_autograd() -> None:
    generator = torch.Generator().manual_seed(1)
    groups = neighbourhoods(torch.rand(70, 3, generator=generator) * 4, 2.0)
    groups = replace(groups, arm=groups.arm.double())
    own, shift, turn = (torch.rand(rows, 3, generator=generator).double() for rows in (70, groups.count, groups.count))
    leaves = [value.requires_grad_() for value in (own, shift, turn)]
    assert torch.autograd.gradcheck(groups.moved, leaves)


def test_groups_follow_a_motion_that_single_anchors_lose() -> None:
    field = random_field(160)
    assert missing_share(field, 2.0) < 0.85 * missing_share(field, 0.0)


def test_what_is_near_is_followed_as_well_where_the_scene_is_deep() -> None:
    """The same anchors on finer levels of a coarser grid: steps and neighbourhoods are theirs, not those of level 0."""
    field = random_field(160)
    octree = Octree(field.octree.origin, 8 * field.octree.root_cell, field.octree.levels + 3)
    deep = replace(field, octree=octree, level=field.level + 3)
    assert missing_share(deep, 2.0) == pytest.approx(missing_share(field, 2.0), abs=1e-3)


def missing_share(field: Field, group_cells: float) -> float:
    """Mean distance that is missing after training to follow a shift by two pixels, as a share of that."""
    config = PredictConfig(epochs=20, minimum_steps=0)
    cameras = tuple(
        pinhole(f"cam{i}", (WIDTH, WIDTH), (WIDTH / 2, HEIGHT / 2), (WIDTH, HEIGHT),
                look_at(np.array([x, -0.4, -3.0]), np.zeros(3), np.array([0.0, -1.0, 0.0])))
        for i, x in enumerate((-1.0, 0.0, 1.0))
    )  # fmt: skip
    scene = scene_of(field, config, cameras, 30.0, 0)
    state = fresh_state(scene, "cpu")
    shift = torch.tensor([0.06, 0.0, 0.0])  # two pixels
    moved = replace(state.field, position=state.field.position + shift)
    blank = Views(cameras, torch.zeros(3, HEIGHT, WIDTH, 3), [0, 1, 2])
    views = replace(blank, targets=rendered(moved, state.alive, blank, "cpu"))
    everything = np.ones(len(state.field), np.bool_)
    changed = torch.ones(3, HEIGHT, WIDTH, dtype=torch.bool)
    parts = (Neighbourhoods(cells=group_cells),) if group_cells else ()
    trainer = training_of(state, everything, views, changed, parts)
    update = trainer.run(config, torch.Generator().manual_seed(0))
    went = torch.from_numpy(update.position) * scene.header.position_steps[0]
    return float((went - shift).norm(dim=1).mean() / shift.norm())
