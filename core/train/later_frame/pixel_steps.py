"""How far a pixel is, in the steps that positions are sent in.

A step is the same length everywhere, and less of a pixel the farther away it is taken. Positions are trained in pixels
instead: at rates in steps, what is near the cameras trembled by more than a pixel in every training step.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from streamlod.core.arrays import Float32
from streamlod.core.camera import Camera
from streamlod.core.train.field.field import Field
from streamlod.core.train.pictures.projection import projected

_UNSEEN = 4.0  # steps a pixel of anchors that no camera shows


def steps_a_pixel(field: Field, position_steps: Float32, cameras: Sequence[Camera]) -> Tensor:
    """[N,1] position steps in which an anchor goes a pixel, in the camera that shows it largest.

    Args:
        position_steps: [L] width of a step of each level, in world units.
    """
    position, step = field.position, torch.from_numpy(position_steps).to(field.position)[field.level]
    pixels = torch.zeros_like(step)
    for camera in cameras:
        _, _, depth, inside = projected(position, camera)
        pixels = torch.where(inside, torch.maximum(pixels, step * float(camera.intrinsics[0, 0]) / depth), pixels)
    return torch.where(pixels > 0, 1 / pixels, _UNSEEN)[:, None]
