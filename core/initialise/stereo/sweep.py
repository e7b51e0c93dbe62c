"""Depth of every view by plane sweep with the known poses (Collins 1996), without training and without features.

Each view is compared with its nearest neighbours, warped as if all they saw lay on a plane at one inverse depth after
another. The cost of a plane at a pixel is half of one minus the zero-mean normalised cross-correlation of 5x5 windows,
which does not mind gain and offset between cameras, plus the window's mean colour difference, clamped; of the
neighbours that see the pixel's point the best two are averaged, since the others may be occluded. Planes lie a pixel of
parallax apart: where they are farther apart, windows miss the true depth and match something else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Float32, Float64
from streamlod.core.camera import Camera
from streamlod.core.initialise.stereo.sweep_kernel import best_planes, cost_volume
from streamlod.core.initialise.views import WorkingViews, pixel_centres, unproject

_NEIGHBOURS, _BEST = 4, 2
_PARALLAX = 1.0  # pixels between neighbouring planes, as the second nearest view sees them
_MIN_PLANES = 64
_SAME_SURFACE = 3  # planes
_DISTINCT = 0.2  # where every other depth costs so much more than the best, that one costs so much less


@dataclass(frozen=True, slots=True, eq=False)
class DepthMap:
    """Depth along the optical axis of one view.

    Attributes:
        camera: of the map's size.
        depth: [H,W] float32, world units, > 0.
        cost: [H,W] float32, 0 where the match is perfect, less where it is distinct as well, 2 where there is none.
    """

    camera: Camera
    depth: Float32
    cost: Float32

    def points(self) -> Float64:
        """[H*W,3] the world point of every pixel, row by row."""
        return unproject(self.camera, pixel_centres(self.camera), self.depth.astype(np.float64).ravel())


def sweep_views(
    views: WorkingViews, bounds: tuple[float, float], planes: int, progress: Callable[[float], None] | None = None
) -> list[DepthMap]:
    """Depth of every view.

    Args:
        bounds: (near, far) depth in world units.
        planes: inverse depths tried, evenly spaced between the bounds.
        progress: called with the fraction done.
    """
    inverse = np.linspace(1 / bounds[1], 1 / bounds[0], planes)
    width, height = views.size
    volume = np.empty((planes, height, width), np.float32)
    images = views.images
    maps = []
    for index, camera in enumerate(views.cameras):
        sources = neighbours(views, index)
        pairs = [pair_geometry(camera, views.cameras[source]) for source in sources]
        rays, shifts = np.stack([pair[0] for pair in pairs]), np.stack([pair[1] for pair in pairs])
        best = min(_BEST, len(sources))
        cost_volume(images[index], images[sources], rays, shifts, inverse, best, volume)
        depth, cost = _minimum(volume, inverse)
        maps.append(DepthMap(camera, depth, cost))
        if progress is not None:
            progress((index + 1) / len(views))
    return maps


def plane_count(views: WorkingViews, bounds: tuple[float, float], most: int) -> int:
    """How many planes between `bounds` lie a pixel of parallax apart, 64 to `most`."""
    baselines, focals = [], []
    for index, camera in enumerate(views.cameras):
        second = neighbours(views, index)[:_BEST][-1]
        baselines.append(float(np.linalg.norm(views.cameras[second].centre - camera.centre)))
        focals.append(float(camera.intrinsics[1, 1]))
    parallax = float(np.median(focals)) * float(np.median(baselines)) * (1 / bounds[0] - 1 / bounds[1])
    return int(np.clip(np.ceil(parallax / _PARALLAX), _MIN_PLANES, max(most, _MIN_PLANES)))


def neighbours(views: WorkingViews, index: int, most: int = _NEIGHBOURS) -> list[int]:
    """The `most` views nearest to view `index`, nearest first."""
    centres = np.stack([camera.centre for camera in views.cameras])
    distance = np.linalg.norm(centres - centres[index], axis=1)
    return [int(i) for i in np.argsort(distance, kind="stable") if i != index][:most]


def pair_geometry(reference: Camera, source: Camera) -> tuple[Float64, Float64]:
    """([3,3], [3]): what takes a pixel of `reference`, and its inverse depth, to the homogeneous pixel of `source`."""
    relative = source.world_to_camera @ np.linalg.inv(reference.world_to_camera)
    rays = source.intrinsics @ relative[:3, :3] @ np.linalg.inv(reference.intrinsics)
    return rays, source.intrinsics @ relative[:3, 3]


def _minimum(volume: Float32, inverse: Float64) -> tuple[Float32, Float32]:
    """([H,W] depth, [H,W] cost) of the best plane, between planes by the parabola through three costs.

    A distinct match costs less: chance agreement of windows without texture never is distinct.
    """
    shape = volume.shape[1:]
    plane, cost, rival = np.empty(shape, np.int64), np.empty(shape, np.float32), np.empty(shape, np.float32)
    best_planes(volume, _SAME_SURFACE, plane, cost, rival)
    middle = np.clip(plane, 1, len(inverse) - 2)[None]
    before, here, after = (np.take_along_axis(volume, middle + step, axis=0)[0] for step in (-1, 0, 1))
    shift = np.clip(0.5 * (before - after) / np.maximum(before - 2 * here + after, 1e-6), -0.5, 0.5)
    best = inverse[0] + (middle[0] + shift) * (inverse[1] - inverse[0])
    distinct = rival - cost > _DISTINCT
    return np.asarray(1 / best, np.float32), np.where(distinct, cost - np.float32(_DISTINCT), cost)
