"""First values of new anchors (paper section V-A, refinement)."""

from __future__ import annotations

import torch
from torch import Tensor

from streamlod.core.train.field.field import Field
from streamlod.core.train.growth.gradient import NewAnchors

_SPREAD = 0.3  # of first offsets, in multiples of the cell: equal Gaussians would stay equal


def first_values(parents: Field, new: NewAnchors, generator: torch.Generator) -> dict[str, Tensor]:
    """The seven arrays of `new` anchors: on their nodes, as wide as their cells, with their parents' features."""
    device = parents.feature.device
    level, voxel = torch.from_numpy(new.level).to(device), torch.from_numpy(new.voxel).to(device)
    cell = parents.octree.root_cell / 2.0 ** level.double()
    offset = torch.randn(len(new), parents.slots, 3, generator=generator, device=generator.device)
    return {
        "level": level,
        "voxel": voxel,
        "extra_level": torch.zeros(len(new), device=device),
        "position": torch.from_numpy(parents.octree.node_of(new.voxel, new.level)).float().to(device),
        "feature": parents.feature[torch.from_numpy(new.parent).to(device)],
        "offset": _SPREAD * offset.to(device),
        "scaling": cell.log().float()[:, None].repeat(1, 6),
    }
