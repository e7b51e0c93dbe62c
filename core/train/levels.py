"""A scene gets the levels it needs: those that carry nothing are not kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from core.octree import Octree

_IDLE = 0.02  # of the loss: a level whose absence costs less than this share carries nothing


def needed_levels(levels: int, loss: Callable[[int, int], float]) -> tuple[int, int]:
    """(first, last) level to keep, at least one.

    Args:
        levels: how many there are.
        loss: of the picture drawn with the levels from one to another only, both included.
    """
    first, last = 0, levels - 1
    limit = (1 + _IDLE) * loss(first, last)
    while last > first and loss(first, last - 1) <= limit:
        last -= 1
    while first < last and loss(first + 1, last) <= limit:
        first += 1
    return first, last


def renumbered(octree: Octree, level: Tensor, first: int, last: int) -> tuple[Octree, Tensor, Tensor]:
    """The octree of levels `first` to `last` alone, the [n] rows of `level` [N] that it holds, and their new levels."""
    rows = torch.nonzero((level >= first) & (level <= last))[:, 0]
    return replace(octree, root_cell=octree.cell(first), levels=last - first + 1), rows, level[rows] - first
