"""Levels in order of effect: what a viewer with the coarsest levels gets is what makes most of the pictures.

The octree's own levels tell how wide the cells are in which anchors grew, which says little about what each is worth.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Float64, Int32, Int64
from streamlod.core.scene.octree import MORTON_REACH, Octree
from streamlod.core.train.field.field import Field

LEVELS = 5
_SHARE = 0.47  # anchors up to a level, of those up to the next; half of its bytes, as what matters is rounded finely


def in_order_of_effect(field: Field, effects: Tensor, cell: float, levels: int = LEVELS) -> Field:
    """The anchors of `field` on levels that tell what each is worth.

    An anchor of any size may come on any level, so cells need only tell anchors apart: level 0 has the narrowest in
    which anchors grew, others are finer yet. Where two ask for one node, one moves to the next free one beside it.

    Args:
        effects: [N] of the anchors, as of `core.train.keyframe.effect`.
        cell: width of the narrowest cells in which anchors grew, in world units.
        levels: how many, or fewer where so many would reach too far.
    """
    place = field.position.cpu().double().numpy()
    span = (place.max(axis=0) - place.min(axis=0)).max() / cell if len(place) else 0.0
    while levels > 1 and (span + 1) * 2.0 ** (levels - 1) >= MORTON_REACH:
        levels -= 1
    level = _levels(effects.cpu().numpy(), levels)
    octree = Octree(field.octree.origin, cell, levels)
    voxel = octree.voxel_of(place, level)
    for number in range(levels):
        here = np.flatnonzero(level == number)
        nodes = _free_nodes(voxel[here], number)
        place[here] += octree.node_of(nodes, number) - octree.node_of(voxel[here], number)
        voxel[here] = nodes
    device = field.level.device
    return replace(
        field,
        octree=octree,
        level=torch.from_numpy(level).to(device),
        voxel=torch.from_numpy(voxel).to(device),
        position=torch.from_numpy(place).to(field.position),
    )


def _levels(effects: Float64, levels: int) -> Int64:
    """[N] levels of anchors of `effects` [N]: the more effect, the coarser."""
    count = len(effects)
    ends = np.ceil(count * _SHARE ** np.arange(levels - 1, -1, -1.0))
    rank = np.empty(count, np.int64)
    rank[np.argsort(-effects, kind="stable")] = np.arange(count)
    return np.searchsorted(ends, rank, side="right").astype(np.int64)


def _free_nodes(nodes: Int32, level: int) -> Int32:
    """[n,3] `nodes` of `level`, no two of them the same: those that are taken give way to others beside them."""
    nodes = nodes.copy()
    aside = 2 ** max(level - 1, 0)  # half a cell of level 0, but there: no anchor of a first frame stands in between
    while True:
        _, first = np.unique(nodes, axis=0, return_index=True)
        if len(first) == len(nodes):
            return nodes
        again = np.ones(len(nodes), np.bool_)
        again[first] = False
        nodes[again, 0] += aside
