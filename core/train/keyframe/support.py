"""How many cameras agree on a place: what several see is shaped by that, what one sees is kept as that one shows it.

Leaving Gaussians out at random, random backgrounds and a price on opacity make surfaces on which cameras agree. Where a
camera has no other to agree with, they only blur what it filmed. Cameras that look at a place from very different
sides do not agree on it either: they see different sides of things.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from streamlod.core.camera import Camera
from streamlod.core.train.pictures.projection import projected

_SAME_SIDE = math.cos(math.radians(60))  # of the angle between two cameras as seen from a place


@torch.no_grad()
def support(visible: Tensor, position: Tensor, cameras: Sequence[Camera]) -> Tensor:
    """[N] from 0, a place that cameras see one from each side, to 1, one that all have in view from about one side.

    The share of the other cameras with which a camera agrees, in the mean of the cameras that have the place in their
    pictures, whatever hides it.

    Args:
        visible: [C,N], see `in_view`.
        position: [N,3] in the world. cameras: C pinholes; of one camera alone there is no agreement.
    """
    towards = [
        functional.normalize(torch.from_numpy(camera.centre).to(position) - position, dim=1) for camera in cameras
    ]
    agreeing = torch.zeros(len(position), device=position.device)
    for one, own in enumerate(towards):
        for other in range(one):
            same_side = (own * towards[other]).sum(dim=1) >= _SAME_SIDE
            agreeing += 2.0 * (visible[one] & visible[other] & same_side)
    return agreeing / (visible.sum(dim=0).clamp_min(1) * max(len(cameras) - 1, 1))


def in_view(position: Tensor, cameras: Sequence[Camera]) -> Tensor:
    """[C,N] bool: which of `cameras` have the places `position` [N,3] in their pictures, whatever hides them."""
    return torch.stack([projected(position, camera)[3] for camera in cameras])
