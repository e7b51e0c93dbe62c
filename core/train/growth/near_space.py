"""Space before the scene, and between cameras, where nothing is but what training puts there.

A Gaussian near a lens can make up for whatever that camera's picture lacks, and hides the scene from everywhere else.
Where first points say how near the scene begins, anchors nearer than that by far are wrong, as are those that no
camera sees: their Gaussians are the accidental children of others.

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
from streamlod.core.camera.beside import views_between
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.views import inside, project
from streamlod.core.render.reference import MAX_ASIDE, NEAR
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.field import Field

_SHARES = (0.25, 0.5)  # of the way from each camera to its neighbours
# Quantiles of the depths of first points: single ones may be wrong, and of those that one camera alone sees many are
# too near.
_NEAREST, _NEAREST_BETWEEN = 0.01, 0.02


@dataclass(frozen=True, slots=True, eq=False)
class NearSpace:
    """How near the scene begins before each of C cameras, and before views between them.

    Attributes:
        cameras: C pinhole cameras. nearest: C depths in world units, 0 where a camera sees no first point.
        between: V pinhole views between them. begins: V depths likewise.
    """

    cameras: tuple[Camera, ...]
    nearest: tuple[float, ...]
    between: tuple[Camera, ...]
    begins: tuple[float, ...]

    @torch.no_grad()
    def astray(self, field: Field, clearance: float) -> Tensor:
        """[N] anchors all of whose Gaussians are unseen, or nearer to a camera than `clearance` of its nearest."""
        points = field.gaussian_means.flatten(0, 1).double().cpu().numpy()
        seen, near = np.zeros((2, len(points)), np.bool_)
        for camera, nearest in zip(self.cameras, self.nearest, strict=True):
            pixels, depth = project(camera, points)
            visible = inside(camera, pixels, depth)
            seen |= visible
            near |= visible & (depth < clearance * nearest)
        wrong = (near | ~seen).reshape(len(field), field.slots).all(axis=1)
        return torch.from_numpy(wrong).to(field.position.device)

    @torch.no_grad()
    def hidden(self, splats: Splats, clearance: float) -> Tensor:
        """[G] share that each Gaussian hides of the picture of a view between, the largest of all; 0 of most Gaussians.

        A Gaussian hides something where it is nearer than `clearance` of the depth at which the scene begins, and its
        centre, or a point one standard deviation beside it, lies in the picture. It hides the area of the ellipse of
        its two longer standard deviations, at most the whole picture.
        """
        middle, widest = splats.scales.sort(dim=1).values[:, 1:].unbind(dim=1)
        means, hidden = splats.means.unbind(dim=1), torch.zeros_like(widest)
        for view, begins in zip(self.between, self.begins, strict=True):
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


def near_space(points: PointCloud, cameras: tuple[Camera, ...]) -> NearSpace:
    """The empty space before `cameras`, and before views between neighbours, as first points tell it."""
    positions = points.positions.astype(np.float64)
    between = tuple(views_between(cameras, _SHARES))
    nearest = tuple(scene_begins(positions, camera, _NEAREST) for camera in cameras)
    return NearSpace(cameras, nearest, between, tuple(scene_begins(positions, v, _NEAREST_BETWEEN) for v in between))


def scene_begins(points: Float64, view: Camera, quantile: float) -> float:
    """The depth at which the scene begins in a view: a low `quantile` of its `points` [N,3]; 0 where it holds none."""
    pixels, depth = project(view, points)
    seen = depth[inside(view, pixels, depth)]
    return float(np.quantile(seen, quantile)) if len(seen) else 0.0
