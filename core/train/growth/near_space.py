"""Space before the scene, where nothing is but what training puts there.

A Gaussian near a lens can make up for whatever that camera's picture lacks, and hides the scene from everywhere else.
Where first points say how near the scene begins, anchors nearer than that by far are wrong, as are those that no
camera sees: their Gaussians are the accidental children of others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from core.camera import Camera
from core.frames import PointCloud
from core.train.field.field import Field

_NEAREST = 0.01  # quantile of the depths of the first points that a camera sees: single points may be wrong


@dataclass(frozen=True, slots=True, eq=False)
class NearSpace:
    """How near the scene begins before each of C cameras.

    Attributes:
        projection: [C,3,4] from world to homogeneous pixels, in units of the picture's width and height.
        nearest: C depths in world units, 0 where a camera sees no first point.
    """

    projection: Tensor
    nearest: tuple[float, ...]

    @torch.no_grad()
    def astray(self, field: Field, clearance: float) -> Tensor:
        """[N] anchors all of whose Gaussians are unseen, or nearer to a camera than `clearance` of its nearest."""
        means = (field.position[:, None] + field.offset * field.scaling.exp()[:, None, :3]).flatten(0, 1)
        seen = torch.zeros(len(means), dtype=torch.bool, device=means.device)
        near = torch.zeros_like(seen)
        for projection, nearest in zip(self.projection, self.nearest, strict=True):
            u, v, depth = (means @ projection[:, :3].T + projection[:, 3]).unbind(dim=1)
            inside = (depth > 0) & (u >= 0) & (u < depth) & (v >= 0) & (v < depth)
            seen |= inside
            near |= inside & (depth < clearance * nearest)
        return (near | ~seen).view(len(field), field.slots).all(dim=1)


def near_space(points: PointCloud, cameras: tuple[Camera, ...], device: torch.device | str = "cpu") -> NearSpace:
    """What first points say of the space before `cameras`."""
    homogeneous = np.concatenate([points.positions, np.ones((len(points), 1), np.float32)], axis=1).astype(np.float64)
    projections, nearest = [], []
    for camera in cameras:
        scale = np.diag([1 / camera.width, 1 / camera.height, 1.0])
        projection = scale @ camera.intrinsics @ camera.world_to_camera[:3]
        u, v, depth = projection @ homogeneous.T
        seen = depth[(depth > 0) & (u >= 0) & (u < depth) & (v >= 0) & (v < depth)]
        projections.append(torch.from_numpy(projection).float())
        nearest.append(float(np.quantile(seen, _NEAREST)) if len(seen) else 0.0)
    return NearSpace(torch.stack(projections).to(device), tuple(nearest))
