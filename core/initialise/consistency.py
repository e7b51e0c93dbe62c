"""Which pixels of several depth maps can be trusted: the tests that make first points clean.

Wrong points near a camera are the worst a first frame can start from (haze before everything else). A pixel counts only
when its match is good, another view agrees with it, fewer views look through it than agree, and it belongs to a piece
of surface of some size. What remains is asked once more, and then only trusted pixels may agree or look through.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import minimum_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from streamlod.core.arrays import Bool, Float32, Float64, Int64
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.stereo.sweep import DepthMap
from streamlod.core.initialise.views import WorkingViews, inside, project

MAX_POINTS = 200_000  # that a cloud keeps: far more than a first frame has anchors
_MANY_VIEWS = 9  # from so many views on, two must agree


@dataclass(frozen=True, slots=True)
class Trust:
    """When a pixel of a depth map is trusted.

    Attributes:
        tolerance: relative depth within which two views agree, and neighbouring pixels lie on one surface.
        cost_by_one, cost_by_more: worst cost of a match that one other view confirms, and that several do. A window
            without texture costs 0.5 at any depth, so that two views agree by chance.
        smallest_piece: share of the picture that a connected piece of surface must cover. A piece nearer than the
            median must cover more, in proportion to its inverse squared depth: what is near is large in the picture.
    """

    tolerance: float = 0.02
    cost_by_one: float = 0.4
    cost_by_more: float = 0.6
    smallest_piece: float = 0.0005


def consistent_points(views: WorkingViews, maps: Sequence[DepthMap], trust: Trust = Trust()) -> PointCloud:
    """The points of all pixels that can be trusted, coloured by the view whose depth they are."""
    return points_of(views, maps, trusted_pixels(maps, trust))


def points_of(views: WorkingViews, maps: Sequence[DepthMap], good: Sequence[Bool]) -> PointCloud:
    """The points of the `good` pixels [H,W] of every map, coloured by the view whose depth they are."""
    points = np.concatenate([depth_map.points()[mask.ravel()] for depth_map, mask in zip(maps, good, strict=True)])
    colours = np.concatenate([image[mask] for image, mask in zip(views.images, good, strict=True)])
    kept = np.arange(len(points))
    if len(kept) > MAX_POINTS:
        kept = kept[np.linspace(0, len(kept) - 1, MAX_POINTS).astype(np.int64)]
    return PointCloud(points[kept].astype(np.float32), colours[kept].astype(np.float32))


def trusted_pixels(maps: Sequence[DepthMap], trust: Trust) -> list[Bool]:
    """[H,W] of each map: which pixels can be trusted."""
    world = [depth_map.points() for depth_map in maps]
    first = []
    for index, depth_map in enumerate(maps):
        good = trusted(world[index], index, maps, trust)
        first.append(in_large_pieces(depth_map.depth, good.reshape(depth_map.depth.shape), trust))
    kept = [
        replace(depth_map, cost=np.where(good, depth_map.cost, np.float32(np.inf)))
        for depth_map, good in zip(maps, first, strict=True)
    ]
    return [
        trusted(world[index], index, kept, trust).reshape(depth_map.depth.shape) for index, depth_map in enumerate(maps)
    ]


def confirmed(maps: Sequence[DepthMap], others: Sequence[DepthMap], trust: Trust) -> list[Bool]:
    """[H,W] of each of `maps`: which pixels have the depth that a trusted pixel of `others`, of the same view, has."""
    return [
        good & (np.abs(depth_map.depth - other.depth) < trust.tolerance * other.depth)
        for depth_map, other, good in zip(maps, others, trusted_pixels(others, trust), strict=True)
    ]


def trusted(world: Float64, index: int, maps: Sequence[DepthMap], trust: Trust) -> Bool:
    """[H*W] which pixels of map `index`, at `world` [H*W,3], match well and are confirmed by other views."""
    worst = max(trust.cost_by_one, trust.cost_by_more)
    sure = knowing(maps, [np.asarray(depth_map.cost < worst) for depth_map in maps])
    agreeing, through = votes(world, index, sure, trust.tolerance)
    needed = 2 if len(maps) >= _MANY_VIEWS else 1
    limit = np.where(agreeing > 1, trust.cost_by_more, trust.cost_by_one)
    return np.asarray((agreeing >= needed) & (through < agreeing) & (maps[index].cost.ravel() < limit))


def knowing(maps: Sequence[DepthMap], good: Sequence[Bool]) -> list[DepthMap]:
    """`maps` that know the depths of their `good` pixels [H,W] alone; those of the others are infinite."""
    return [
        replace(depth_map, depth=np.where(mask, depth_map.depth, np.float32(np.inf)))
        for depth_map, mask in zip(maps, good, strict=True)
    ]


def votes(points: Float64, index: int, maps: Sequence[DepthMap], tolerance: float) -> tuple[Float64, Float64]:
    """([N] views that see a surface at `points` [N,3], [N] views that look through them), map `index` left out.

    A view looks through a point where it sees only farther surfaces in the 3x3 pixels round it. Infinite depths say
    nothing.
    """
    agreeing, through = np.zeros(len(points)), np.zeros(len(points))
    for other, depth_map in enumerate(maps):
        if other == index:
            continue
        pixels, depth = project(depth_map.camera, points)
        seen = inside(depth_map.camera, pixels, depth)
        column, row = np.where(seen[:, None], pixels, 0).astype(np.int64).T
        there = depth_map.depth[row, column]
        nearest = minimum_filter(depth_map.depth, 3)[row, column]
        agreeing += seen & (np.abs(there - depth) < tolerance * depth)
        through += seen & np.isfinite(there) & (depth < nearest * (1 - 2 * tolerance))
    return agreeing, through


def in_large_pieces(depth: Float32, good: Bool, trust: Trust) -> Bool:
    """[H,W] which of the `good` pixels belong to a connected piece of surface that is large enough."""
    if not good.any():
        return good
    piece = pieces(depth, good, trust.tolerance)
    size = np.minimum((depth / np.median(depth[good])) ** 2, 1.0).ravel() * good.ravel()
    large = np.bincount(piece, weights=size) >= trust.smallest_piece * depth.size
    return np.asarray(good & large[piece].reshape(depth.shape))


def pieces(depth: Float32, good: Bool, tolerance: float) -> Int64:
    """[H*W] number of the piece of surface that each of the `good` pixels [H,W] belongs to; others are by themselves.

    Args:
        tolerance: relative difference of depths [H,W] of neighbouring pixels of one surface.
    """
    number = np.arange(depth.size).reshape(depth.shape)
    pairs = []
    for before, after in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        joined = good[before] & good[after]
        joined &= np.abs(depth[before] - depth[after]) < tolerance * depth[after]
        pairs.append(np.stack([number[before][joined], number[after][joined]]))
    one, other = np.concatenate(pairs, axis=1)
    graph = coo_matrix((np.ones(len(one), np.bool_), (one, other)), (depth.size, depth.size))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)
