"""Which anchors move steadily.

Something slow or smooth changes few pixels from one picture to the next, but training moves its anchors the same way
frame after frame, while anchors that only look different tremble in place. So the mean of an anchor's latest motions
says more than one frame's pictures do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool
from streamlod.core.camera import Camera

_LATEST = 0.1  # weight of the latest motion in the mean
_PIXELS = 1 / 20  # a frame, in the camera that sees most of it


def mean_motion(before: Tensor | None, motion: Tensor) -> Tensor:
    """[N,3] running mean in world units a frame, of the mean `before` (None at first) and the latest `motion`."""
    return _LATEST * motion if before is None else torch.lerp(before, motion, _LATEST)


def pixels_a_unit(positions: Tensor, cameras: Sequence[Camera]) -> Tensor:
    """[N] how many pixels a world unit at `positions` [N,3] is wide at most, in the camera that sees it largest."""
    most = torch.zeros(len(positions), device=positions.device)
    for camera in cameras:
        centre = torch.from_numpy(camera.centre).to(positions)
        scale = float(camera.intrinsics[0, 0]) / (positions - centre).norm(dim=1).clamp_min(1e-6)
        most = torch.maximum(most, scale)
    return most


def moves_steadily(motion: Tensor | None, positions: Tensor, cameras: Sequence[Camera]) -> Bool:
    """[N] bool: whose mean `motion` [N,3] at `positions` [N,3] is a twentieth of a pixel a frame to any camera."""
    if motion is None:
        return np.zeros(len(positions), np.bool_)
    return np.asarray((motion.norm(dim=1) * pixels_a_unit(positions, cameras) >= _PIXELS).cpu().numpy())
