"""Random points in the space that the cameras share, where nothing better can be had."""

from __future__ import annotations

import logging

import numpy as np

from streamlod.core.arrays import Bool, Float32, Float64
from streamlod.core.errors import ModelError
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.method import PointSources
from streamlod.core.initialise.views import WorkingViews, inside, project, unproject

_ROWS = 160  # of the pictures from which colours and bounds are taken
_COUNT = 8000
_ATTEMPTS = 20
_log = logging.getLogger(__name__)


def random_points(sources: PointSources) -> PointCloud:
    """Points spread over the volume that at least two cameras see (all of it, with one), evenly in inverse depth.

    Colours are the mean of what the cameras see there.

    Raises:
        InputError: as `PointSources.bounds`.
        ModelError: no two cameras see the same space between the bounds.
    """
    _log.warning("starting from %d random points: expect a worse first frame than with measured ones", _COUNT)
    views = sources.views(_ROWS)
    bounds = sources.bounds(views)
    generator = np.random.default_rng(sources.seed)
    needed = min(2, len(views))
    positions, colours, missing = [], [], _COUNT
    for _ in range(_ATTEMPTS):
        points = _in_frusta(views, bounds, _COUNT, generator)
        rgb, seen = sample_colours(views, points)
        good = np.flatnonzero(seen >= needed)[:missing]
        positions.append(points[good])
        colours.append(rgb[good])
        missing -= len(good)
        if missing == 0:
            break
    if missing == _COUNT:
        raise ModelError("no two cameras see the same space between the depth bounds; check poses and depth bounds")
    return PointCloud(np.concatenate(positions).astype(np.float32), np.concatenate(colours))


def sample_colours(views: WorkingViews, points: Float64) -> tuple[Float32, Float64]:
    """([N,3] mean colour of [N,3] `points` over the views that have them in the picture, [N] number of those)."""
    total, count = np.zeros((len(points), 3), np.float64), np.zeros(len(points))
    for camera, image in zip(views.cameras, views.images, strict=True):
        pixels, depth = project(camera, points)
        seen: Bool = inside(camera, pixels, depth)
        column, row = pixels[seen].astype(np.int64).T
        total[seen] += image[row, column]
        count += seen
    return np.asarray(total / np.maximum(count, 1)[:, None], np.float32), count


def _in_frusta(views: WorkingViews, bounds: tuple[float, float], count: int, generator: np.random.Generator) -> Float64:
    """[count,3] points at random pixels of random cameras."""
    of = generator.integers(len(views), size=count)
    pixels = generator.random((count, 2)) * views.size
    depth = 1 / generator.uniform(1 / bounds[1], 1 / bounds[0], count)
    points = np.empty((count, 3))
    for index, camera in enumerate(views.cameras):
        mine = of == index
        points[mine] = unproject(camera, pixels[mine], depth[mine])
    return points


METHODS = {"random": random_points}
