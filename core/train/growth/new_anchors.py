"""Anchors that come in during a later frame: chosen, started, and put into integers (paper section V-A, refinement)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from core.arrays import Float32, Int16, Int32
from core.scene.anchors import AnchorLevel, SceneHeader
from core.train.field.field import Field
from core.train.growth.rule import NewAnchors

_SPREAD = 0.3  # of first offsets, in multiples of the cell: equal ones would never part


def strongest(new: NewAnchors, pull: Tensor, limit: int) -> NewAnchors:
    """At most `limit` of `new`, those whose parents pull hardest; `pull` [n,K] are the parents' gradient norms."""
    if len(new) <= limit:
        return new
    order = np.argsort(-pull.amax(dim=1).cpu().numpy()[new.parent], kind="stable")[:limit]
    order.sort()
    return NewAnchors(new.voxel[order], new.level[order], new.parent[order])


def newcomers(base: Field, parents: Field, new: NewAnchors, header: SceneHeader) -> Field:
    """`base` with `new` appended; they start with their parents' present features, on the grids of `header`.

    Args:
        base: the dynamic anchors, without residuals.
        parents: the same rows with residuals.
    """
    device = base.feature.device
    parent, level = torch.from_numpy(new.parent).to(device), torch.from_numpy(new.level).to(device)
    voxel = torch.from_numpy(new.voxel).to(device)
    cell = base.octree.root_cell / 2.0 ** level.double()
    generator = torch.Generator().manual_seed(len(base))
    offset = _SPREAD * torch.randn(len(new), base.slots, 3, generator=generator)
    first = {
        "level": level,
        "voxel": voxel,
        "extra_level": torch.zeros(len(new), device=device),
        "position": (torch.from_numpy(base.octree.origin).to(device) + voxel * cell[:, None]).float(),
        "feature": _on_grid(parents.feature[parent], header.feature_steps),
        "offset": _on_grid(offset.reshape(len(new), -1).to(device), header.offset_steps).reshape(offset.shape),
        "scaling": _on_grid(cell.log().float()[:, None].repeat(1, 6), header.scaling_steps),
    }
    return base.with_appended(first)


def added_levels(field: Field, latent: Int32, position: Int32, header: SceneHeader) -> tuple[AnchorLevel, ...]:
    """Anchors of `field` with their trained `latent` [n,24] and `position` [n,3], by level, as they are sent."""
    levels = []
    of_anchor = field.level.cpu().numpy()
    for number in range(field.octree.levels):
        rows = np.flatnonzero(of_anchor == number)
        count = len(rows)
        levels.append(
            AnchorLevel(
                voxel=field.voxel.cpu().numpy()[rows],
                position=position[rows],
                feature=_quanta(field.feature[rows], header.feature_steps),
                offset=_quanta(field.offset[rows].flatten(1), header.offset_steps),
                scaling=_quanta(field.scaling[rows], header.scaling_steps),
                extra_level=np.zeros(count, np.int16),
                latent=latent[rows].clip(-32768, 32767).astype(np.int16),
                alive=np.ones(count, np.bool_),
            )
        )
    return tuple(levels)


def _on_grid(values: Tensor, steps: Float32) -> Tensor:
    width = torch.from_numpy(steps).to(values.device)
    return (values / width).round() * width


def _quanta(values: Tensor, steps: Float32) -> Int16:
    rounded = np.round(values.detach().cpu().numpy() / steps)
    return np.nan_to_num(rounded).clip(-32768, 32767).astype(np.int16)
