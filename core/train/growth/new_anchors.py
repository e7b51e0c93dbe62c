"""New anchors: their first values, and the integers that are sent (paper section V-A, refinement)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Float32, Int16, Int32
from streamlod.core.scene.anchors import LATENTS, AnchorLevel, SceneHeader
from streamlod.core.scene.expand import EXTRA_LEVEL_UNIT
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
        "position": (torch.from_numpy(parents.octree.origin).to(device) + voxel * cell[:, None]).float(),
        "feature": parents.feature[torch.from_numpy(new.parent).to(device)],
        "offset": _SPREAD * offset.to(device),
        "scaling": cell.log().float()[:, None].repeat(1, 6),
    }


def added_levels(field: Field, position: Int32, header: SceneHeader) -> tuple[AnchorLevel, ...]:
    """Anchors of `field`, `position` [n,3] steps from their nodes, by level, as they are sent."""
    levels = []
    of_anchor = field.level.cpu().numpy()
    for number in range(field.octree.levels):
        rows = np.flatnonzero(of_anchor == number)
        count = len(rows)
        levels.append(
            AnchorLevel(
                voxel=field.voxel.cpu().numpy()[rows],
                position=position[rows],
                feature=_integers(field.feature[rows], header.feature_steps),
                offset=_integers(field.offset[rows].flatten(1), header.offset_steps),
                scaling=_integers(field.scaling[rows], header.scaling_steps),
                extra_level=_integers(field.extra_level[rows].clamp(min=0), np.float32(EXTRA_LEVEL_UNIT)),
                latent=np.zeros((count, LATENTS), np.int16),
                alive=np.ones(count, np.bool_),
            )
        )
    return tuple(levels)


def _integers(values: Tensor, steps: Float32 | np.float32) -> Int16:
    rounded = np.round(values.detach().cpu().numpy() / steps)
    return np.nan_to_num(rounded).clip(-32768, 32767).astype(np.int16)
