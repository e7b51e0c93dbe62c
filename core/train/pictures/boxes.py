"""The part of a picture that is worth looking at."""

from __future__ import annotations

import torch
from torch import Tensor


def around(mask: Tensor, room: int) -> tuple[slice, slice]:
    """Rows and columns of the smallest box that holds the pixels of `mask` [H,W], some at least, and `room` around."""
    sides = []
    for axis in (1, 0):
        inside = torch.nonzero(mask.any(dim=axis))[:, 0]
        sides.append(slice(max(int(inside[0]) - room, 0), int(inside[-1]) + room + 1))
    return sides[0], sides[1]
