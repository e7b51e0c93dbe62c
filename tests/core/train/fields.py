"""Small random fields for tests of the trainer."""

from __future__ import annotations

import numpy as np
import torch

from streamlod.core.scene.octree import Octree
from streamlod.core.train.config import ModelConfig
from streamlod.core.train.field.field import Field
from streamlod.core.train.keyframe.seeding import _first_network


def random_field(
    anchors: int, slots: int = 4, *, view_dependent: bool = False, levels: int = 3, seed: int = 0
) -> Field:
    """A field of distinct nodes around the origin with values of ordinary size."""
    generator = torch.Generator().manual_seed(seed)
    octree = Octree(origin=np.array([-1.0, -1.0, -1.0]), root_cell=0.25, levels=levels)
    cells = torch.randperm(8**3, generator=generator)[:anchors]
    voxel = torch.stack([cells // 64, cells // 8 % 8, cells % 8], dim=1).to(torch.int32)
    level = torch.arange(anchors) % levels
    cell = octree.root_cell / 2.0 ** level.double()
    features = 8
    config = ModelConfig(gaussians_per_anchor=slots, features=features, view_dependent=view_dependent)
    network = _first_network(config, generator)
    network.output_bias[:slots] = 0.0
    return Field(
        octree=octree,
        reference_distance=6.0,
        view_dependent=view_dependent,
        level=level,
        voxel=voxel,
        extra_level=torch.rand(anchors, generator=generator),
        position=(torch.from_numpy(octree.origin) + voxel * cell[:, None]).float(),
        feature=torch.randn(anchors, features, generator=generator),
        offset=torch.randn(anchors, slots, 3, generator=generator),
        scaling=cell.log().float()[:, None] + 0.3 * torch.randn(anchors, 6, generator=generator),
        network=network,
    )
