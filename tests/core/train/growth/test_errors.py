"""New anchors stand where pictures err: on the true surface, and only where that is worth their bits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from streamlod.core.camera import Camera
from streamlod.core.synthetic import SyntheticSpec, ground_truth, open_synthetic
from streamlod.core.train.field.field import Field
from streamlod.core.train.growth.errors import ErrorNodes, error_nodes, values_at
from streamlod.core.train.pictures.views import Views
from tests.core.train.fields import random_field

SPEC = SyntheticSpec(cameras=4, frames=1, width=128, height=72)
Case = tuple[Field, Views, dict[int, Tensor], Tensor]


@pytest.fixture(scope="module")
def case() -> Case:
    """Anchors along the first camera's axis, the pictures, and the same without what lies 2 to 4 m from that camera."""
    clip = open_synthetic(SPEC)
    (frame,) = clip.frames()
    views = Views(clip.cameras, torch.from_numpy(frame.images).float() / 255, list(range(4)))
    camera = clip.cameras[0]
    line = camera.centre + np.outer(np.linspace(0.5, 9, 60), camera.world_to_camera[2, :3])
    living = replace(random_field(60), position=torch.from_numpy(line).float())
    drawn = {}
    for number in views.usable:
        depth = torch.from_numpy(ground_truth(SPEC, 0, number).depth)
        lacking = ((depth > 2) & (depth < 4))[..., None]
        drawn[number] = torch.where(lacking, views.targets[number] * 0.4, views.targets[number])
    return living, views, drawn, torch.ones(4, SPEC.height, SPEC.width, dtype=torch.bool)


def distance_to_surface(nodes: ErrorNodes, camera: Camera, number: int) -> tuple[Tensor, Tensor]:
    """[n] relative depth of each spot behind what `camera` sees there, and whether it lies in the picture."""
    rotation, shift = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    seen = nodes.position @ rotation.T + shift
    pixel = seen @ camera.intrinsics.T
    column, row = (pixel[:, :2] / pixel[:, 2:]).astype(int).T
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    depth = ground_truth(SPEC, 0, number).depth[np.where(inside, row, 0), np.where(inside, column, 0)]
    return torch.from_numpy(seen[:, 2] / depth - 1), torch.from_numpy(inside)


def test_they_lie_on_the_surface_that_is_lacking(case: Case) -> None:
    living, views, drawn, masks = case
    nodes = error_nodes(living, views, drawn, masks, 60, 0.0)
    assert 10 < len(nodes) <= 60
    away, inside = distance_to_surface(nodes, views.cameras[0], 0)
    near = away[inside].abs() < 0.06
    assert near.float().mean() > 0.6
    cell = living.octree.root_cell / 2.0**nodes.level
    node = living.octree.origin + nodes.voxel * cell[:, None]
    assert (np.abs(nodes.position - node) <= 0.5 * cell[:, None] + 1e-6).all()
    assert len(np.unique(np.concatenate([nodes.level[:, None], nodes.voxel], axis=1), axis=0)) == len(nodes)


def test_only_error_that_counts_and_is_worth_an_anchor_gets_one(case: Case) -> None:
    living, views, drawn, masks = case
    many = len(error_nodes(living, views, drawn, masks, 60, 0.0))
    few = len(error_nodes(living, views, drawn, masks, 60, 2.4))
    assert 0 < few < many
    assert len(error_nodes(living, views, drawn, masks, 60, 1e3)) == 0
    assert len(error_nodes(living, views, drawn, torch.zeros_like(masks), 60, 0.0)) == 0
    right = dict(enumerate(views.targets))
    assert len(error_nodes(living, views, right, masks, 60, 0.0)) == 0
    assert len(error_nodes(living, views, drawn, masks, 7, 0.0)) <= 7
    assert len(error_nodes(living, views, drawn, masks, 0, 0.0)) == 0


def test_they_begin_with_the_features_of_an_anchor_of_their_colour(case: Case) -> None:
    living, views, drawn, masks = case
    nodes = error_nodes(living, views, drawn, masks, 20, 0.0)
    values = values_at(living, nodes, torch.Generator().manual_seed(0))
    assert all(len(value) == len(nodes) for value in values.values())
    rows = [int((living.feature == feature).all(dim=1).nonzero()[0, 0]) for feature in values["feature"]]
    splats = living.decode(torch.zeros(3))
    opacity = splats.opacities.reshape(len(living), -1).amin(dim=1)
    colours = splats.colours.reshape(len(living), -1, 3)
    plain = (opacity > 0.3) & ((colours.amax(dim=1) - colours.amin(dim=1)).amax(dim=1) < 0.1)
    away = (colours.mean(dim=1)[None] - torch.from_numpy(nodes.colour).float()[:, None]).norm(dim=2)
    models = plain if bool(plain.any()) else torch.ones_like(plain)
    assert torch.allclose(away[torch.arange(len(nodes)), torch.tensor(rows)], away[:, models].amin(dim=1))
