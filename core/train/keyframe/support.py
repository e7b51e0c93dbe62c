"""How many cameras see a place: what several see is shaped by agreement, what one sees is kept as that one shows it.

Leaving Gaussians out at random, and a price on opacity, make surfaces on which cameras agree. Where a camera has no
other to agree with, they only blur what it filmed.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from streamlod.core.camera import Camera

_LEAST_PRICE = 0.25  # of the price on opacity, for what one camera alone sees: what no picture needs still goes


@torch.no_grad()
def support(position: Tensor, cameras: Sequence[Camera]) -> Tensor:
    """[N] from 0, a place that at most one camera has in its picture, to 1, one that all have, whatever hides it.

    Args:
        position: [N,3] in the world. cameras: C pinholes; of one camera alone there is no agreement.
    """
    seen = torch.zeros(len(position), device=position.device)
    for camera in cameras:
        pose = torch.from_numpy(camera.world_to_camera).to(position)
        lens = torch.from_numpy(camera.intrinsics).to(position)
        x, y, depth = (position @ pose[:3, :3].T + pose[:3, 3]).unbind(dim=1)
        safe = depth.clamp_min(1e-6)
        column, row = lens[0, 0] * x / safe + lens[0, 2], lens[1, 1] * y / safe + lens[1, 2]
        seen += (depth > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    return ((seen - 1) / max(len(cameras) - 1, 1)).clamp(0, 1)


def price_share(supported: Tensor) -> Tensor:
    """[N] share of the price on opacity that Gaussians of this `support` [N] pay."""
    return _LEAST_PRICE + (1 - _LEAST_PRICE) * supported
