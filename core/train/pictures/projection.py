"""Places in the pictures of pinhole cameras, on the places' device; `core.initialise.views.project` is for NumPy."""

from __future__ import annotations

import torch
from torch import Tensor

from streamlod.core.camera import Camera

_NEAREST = 1e-6  # depth that pixels of nearer places are worked out for; those behind the camera mean nothing


def projected(position: Tensor, camera: Camera) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Columns [N], rows [N] and depths [N] of places `position` [N,3] in the world, and [N] bool of those in view.

    In view is what lies within the picture and before the camera, whatever hides it.
    """
    pose = torch.from_numpy(camera.world_to_camera).to(position)
    (fx, _, cx), (_, fy, cy), _ = camera.intrinsics.tolist()
    x, y, depth = (position @ pose[:3, :3].T + pose[:3, 3]).unbind(dim=1)
    safe = depth.clamp_min(_NEAREST)
    column, row = fx * x / safe + cx, fy * y / safe + cy
    within = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    return column, row, depth, within & (depth > 0)
