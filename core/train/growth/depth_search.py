"""Where in space single pixels lie: the depths at which their windows match other views (Collins 1996).

A plane sweep of whole pictures costs more than a later frame has time for; a few hundred pixels cost little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from streamlod.core.arrays import Float32, Float64, Int64
from streamlod.core.camera import Camera
from streamlod.core.initialise.stereo.sweep import pair_geometry
from streamlod.core.initialise.views import unproject
from streamlod.core.train.field.field import Field
from streamlod.core.train.kernels.windows import best_depths
from streamlod.core.train.pictures.projection import projected
from streamlod.core.train.pictures.views import Views

_OTHERS = 3  # nearest views that a pixel is looked for in
_PARALLAX = 1.0  # pixels between depths, as the second nearest view sees them
_MIN_DEPTHS, _MAX_DEPTHS = 16, 96
_NEAREST, _FARTHEST = 0.01, 0.99  # quantiles of the depths of anchors that are there already
_ROOM = 1.05  # and so much beyond them


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPixels:
    """n pixels of one view.

    Attributes:
        view: number of the view. row, column: [n] of the pixels.
        position: [n,3] in the world. width: [n] of a pixel there, in world units.
    """

    view: int
    row: Int64
    column: Int64
    position: Float64
    width: Float64


def matched_pixels(living: Field, views: Views, number: int, row: Int64, column: Int64) -> MatchedPixels:
    """Pixels `row`, `column` [n] of view `number` at the depths that match the nearest usable views best.

    Args:
        living: anchors, which say how deep the scene is.
    """
    camera = views.cameras[number]
    away = {
        other: float(np.linalg.norm(views.cameras[other].centre - camera.centre))
        for other in views.usable
        if other != number
    }
    others = sorted(away, key=away.__getitem__)[:_OTHERS]
    if not others:
        return MatchedPixels(number, row[:0], column[:0], np.zeros((0, 3)), np.zeros(0))
    inverse = inverse_depths(living, camera, away[others[:2][-1]])
    pictures = [views.targets[view].cpu().numpy() for view in (number, *others)]
    plane, _ = best_planes(
        pictures[0], np.stack(pictures[1:]), camera, [views.cameras[v] for v in others], inverse, row, column
    )
    depth = 1 / inverse[plane]
    pixels = np.stack([column + 0.5, row + 0.5], axis=1)
    return MatchedPixels(number, row, column, unproject(camera, pixels, depth), depth / camera.intrinsics[0, 0])


def best_planes(
    picture: Float32,
    sources: Float32,
    camera: Camera,
    others: list[Camera],
    inverse: Float64,
    row: Int64,
    column: Int64,
) -> tuple[Int64, Float32]:
    """([n] which of the depths `inverse` [D] fits pixels `row`, `column` [n] of `picture` best, [n] its cost).

    Args:
        picture: [H,W,3] of `camera`, in [0, 1]; sources: [S,H,W,3] of `others`.
    """
    pairs = [pair_geometry(camera, other) for other in others]
    rays, shifts = (np.stack([pair[part] for pair in pairs]) for part in range(2))
    plane, cost = np.empty(len(row), np.int64), np.empty(len(row), np.float32)
    workers = max(1, min(numba.get_num_threads(), len(row)))
    best_depths(workers, picture, sources, rays, shifts, inverse, column, row, plane, cost)
    return plane, cost


def inverse_depths(living: Field, camera: Camera, baseline: float) -> Float64:
    """[D] inverse depths, a pixel of parallax apart for a view `baseline` world units away, over all that is there."""
    depth = projected(living.position, camera)[2].cpu().numpy()
    nearest, farthest = np.quantile(depth[depth > 0], [_NEAREST, _FARTHEST]) if (depth > 0).any() else (1.0, 2.0)
    ends = 1 / (farthest * _ROOM), _ROOM / nearest
    steps = np.ceil(float(camera.intrinsics[0, 0]) * baseline * (ends[1] - ends[0]) / _PARALLAX)
    return np.linspace(*ends, int(np.clip(steps + 1, _MIN_DEPTHS, _MAX_DEPTHS)))
