"""Which pixels of several depth maps can be trusted: the tests that make first points clean.

Wrong points near a camera are the worst a first frame can start from (haze before everything else), so a pixel counts
only when another view agrees with it, fewer views look through it than agree, and it has company in space.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from core.arrays import Bool, Float32, Float64
from core.frames import PointCloud
from core.initialise.sweep import DepthMap
from core.initialise.views import Views, inside, project

TOLERANCE = 0.02  # relative depth within which two views agree
_WORST_COST = 0.6
_MANY_VIEWS = 9  # from so many views on, two must agree
_COMPANY = 3  # points that a cell must hold
_CELL = 0.01  # of the scene's extent
_MOST = 200_000  # points that a cloud keeps: far more than a first frame has anchors


def consistent_points(views: Views, maps: Sequence[DepthMap], tolerance: float = TOLERANCE) -> PointCloud:
    """The points of all maps that pass, coloured by the view whose depth they are."""
    positions, colours = [], []
    for index, depth_map in enumerate(maps):
        world = depth_map.points()
        good = trusted(world, index, maps, tolerance)
        positions.append(world[good])
        colours.append(views.images[index].reshape(-1, 3)[good])
    points, rgb = np.concatenate(positions), np.concatenate(colours)
    kept = np.flatnonzero(with_company(points))
    if len(kept) > _MOST:
        kept = kept[np.linspace(0, len(kept) - 1, _MOST).astype(np.int64)]
    return PointCloud(points[kept].astype(np.float32), rgb[kept].astype(np.float32))


def trusted(world: Float64, index: int, maps: Sequence[DepthMap], tolerance: float = TOLERANCE) -> Bool:
    """[H*W] which pixels of map `index`, at `world` [H*W,3], other views confirm."""
    agreeing, through = np.zeros(len(world), np.int32), np.zeros(len(world), np.int32)
    for other, depth_map in enumerate(maps):
        if other == index:
            continue
        pixels, depth = project(depth_map.camera, world)
        seen = inside(depth_map.camera, pixels, depth)
        column, row = np.where(seen[:, None], pixels, 0).astype(np.int64).T
        there, cost = depth_map.depth[row, column], depth_map.cost[row, column]
        agreeing += seen & (np.abs(there - depth) < tolerance * depth)
        through += seen & (depth < there * (1 - 2 * tolerance)) & (cost < _WORST_COST)
    needed = 2 if len(maps) >= _MANY_VIEWS else 1
    return np.asarray((agreeing >= needed) & (through < agreeing) & (maps[index].cost.ravel() < _WORST_COST))


def with_company(points: Float64) -> Bool:
    """[N] which points share their cell, of 1 % of the scene's extent, with at least two others."""
    if len(points) == 0:
        return np.zeros(0, np.bool_)
    cell = _CELL * extent(points)
    if cell <= 0:
        return np.ones(len(points), np.bool_)
    index = np.floor(np.clip((points - np.median(points, axis=0)) / cell, -(2**19), 2**19)).astype(np.int64)
    key = ((index[:, 0] + 2**20) << 42) + ((index[:, 1] + 2**20) << 21) + index[:, 2] + 2**20
    _, cell_of, count = np.unique(key, return_inverse=True, return_counts=True)
    return np.asarray(count[cell_of] >= _COMPANY)


def extent(points: Float64 | Float32) -> float:
    """Diagonal of the box that holds the points without the outer 2 % on each side."""
    low, high = np.quantile(points, (0.02, 0.98), axis=0)
    return float(np.linalg.norm(high - low))
