"""Space before the scene, where nothing is but what training puts there.

A Gaussian near a lens can make up for whatever that camera's picture lacks, and hides the scene from everywhere else.
Where first points say how near the scene begins, anchors nearer than that by far are wrong, as are those that no
camera sees: their Gaussians are the accidental children of others. What hangs between cameras is priced (`between`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from streamlod.core.camera import Camera
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.views import inside, project
from streamlod.core.train.field.field import Field
from streamlod.core.train.growth.between import ViewsBetween, scene_begins, views_between

_NEAREST = 0.01  # quantile of the depths of the first points that a camera sees: single points may be wrong


@dataclass(frozen=True, slots=True, eq=False)
class NearSpace:
    """How near the scene begins before each of C cameras, and before views between them.

    Attributes:
        cameras: C pinhole cameras.
        nearest: C depths in world units, 0 where a camera sees no first point.
        between: views between the cameras.
    """

    cameras: tuple[Camera, ...]
    nearest: tuple[float, ...]
    between: ViewsBetween

    @torch.no_grad()
    def astray(self, field: Field, clearance: float) -> Tensor:
        """[N] anchors all of whose Gaussians are unseen, or nearer to a camera than `clearance` of its nearest."""
        means = field.position[:, None] + field.offset * field.scaling.exp()[:, None, :3]
        points = means.flatten(0, 1).double().cpu().numpy()
        seen, near = np.zeros((2, len(points)), np.bool_)
        for camera, nearest in zip(self.cameras, self.nearest, strict=True):
            pixels, depth = project(camera, points)
            visible = inside(camera, pixels, depth)
            seen |= visible
            near |= visible & (depth < clearance * nearest)
        wrong = (near | ~seen).reshape(len(field), field.slots).all(axis=1)
        return torch.from_numpy(wrong).to(field.position.device)


def near_space(points: PointCloud, cameras: tuple[Camera, ...]) -> NearSpace:
    """The empty space before `cameras` and between them, as first points tell it."""
    positions = points.positions.astype(np.float64)
    nearest = tuple(scene_begins(positions, camera, _NEAREST) for camera in cameras)
    return NearSpace(cameras, nearest, views_between(points, cameras))
