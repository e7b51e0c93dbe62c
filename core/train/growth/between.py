"""Space between cameras, through which viewers go, and what hangs there before them.

A camera that alone sees a place from afar tells nothing of its depth. What is then put too near hides the scene from a
viewer between two other cameras. No picture shows that, so no picture prevents it: Gaussians pay for what they hide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera
from streamlod.core.camera.beside import views_beside
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.views import inside, project
from streamlod.core.render.reference import MAX_ASIDE, NEAR
from streamlod.core.train.field.decode import Splats

_SHARES = (0.25, 0.5)  # of the way from each camera to its nearest neighbour
_NEAREST = 0.02  # quantile of the depths of first points: of those that one camera alone sees, many are too near


@dataclass(frozen=True, slots=True, eq=False)
class ViewsBetween:
    """What viewers between cameras see.

    Attributes:
        views: V pinhole views.
        begins: V depths in world units at which the scene begins, 0 where no first point is in view.
    """

    views: tuple[Camera, ...]
    begins: tuple[float, ...]

    @torch.no_grad()
    def hidden(self, splats: Splats, clearance: float) -> Tensor:
        """[G] share of a view's picture that each Gaussian hides, the largest of all views; 0 of most Gaussians.

        A Gaussian hides something where it is nearer than `clearance` of the depth at which the scene begins, and its
        centre, or a point one standard deviation beside it, lies in the picture. It hides the area of the ellipse of
        its two longer standard deviations, at most the whole picture.

        Args:
            splats: G Gaussians in the world.
            clearance: as `KeyframeConfig.clearance`.
        """
        middle, widest = splats.scales.sort(dim=1).values[:, 1:].unbind(dim=1)
        means, hidden = splats.means.unbind(dim=1), torch.zeros_like(widest)
        for view, begins in zip(self.views, self.begins, strict=True):
            rows = view.world_to_camera[:3].tolist()  # numbers, since a tensor would have to be copied to the device
            x, y, depth = (a * means[0] + b * means[1] + c * means[2] + d for a, b, c, d in rows)
            in_way = (depth > NEAR) & (depth < clearance * begins)
            (fx, _, cx), (_, fy, cy), _ = view.intrinsics.tolist()
            unit = fx / depth.clamp_min(NEAR)  # pixels of one world unit
            for centre, size in ((unit * x + cx, view.width), (unit * fy / fx * y + cy, view.height)):
                away = (centre - 0.5 * size).abs()
                in_way &= (away <= 0.5 * size + unit * widest) & (away <= MAX_ASIDE * size)
            share = torch.pi * unit.square() * widest * middle / (view.width * view.height)
            hidden = torch.maximum(hidden, in_way * share.clamp(max=1.0))
        return hidden


def views_between(points: PointCloud, cameras: tuple[Camera, ...]) -> ViewsBetween:
    """Views a quarter of the way and half way from each of `cameras` to its neighbour, with first points `points`."""
    views = tuple(view for share in _SHARES for view in views_beside(cameras, share))
    positions = points.positions.astype(np.float64)
    return ViewsBetween(views, tuple(scene_begins(positions, view, _NEAREST) for view in views))


def scene_begins(points: Float64, view: Camera, quantile: float) -> float:
    """The depth at which the scene begins in a view: a low `quantile` of its `points` [N,3]; 0 where it holds none."""
    pixels, depth = project(view, points)
    seen = depth[inside(view, pixels, depth)]
    return float(np.quantile(seen, quantile)) if len(seen) else 0.0
