"""Depth of every view by slanted windows, starting from a plane sweep (PatchMatch stereo; Bleyer et al. 2011).

A sweep compares windows that face the camera. Seen by cameras far apart, floors, tables and walls do not, and have no
depth at which such windows agree. Here every pixel has a plane of its own, and takes over a neighbour's plane where
that fits better, or a random change of its own. Neighbours wait for one another as the two colours of a chessboard
(Galliani et al. 2015). The first round looks at small pictures, a quarter of the work. In later rounds a plane costs
more where the sources' own surfaces lie elsewhere (Xu and Tao 2019).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Float32, Float64
from streamlod.core.camera import Camera
from streamlod.core.initialise.stereo.patch_kernel import SAMPLES, UNSEEN, Pairs, improve, plane_costs, window_weights
from streamlod.core.initialise.stereo.planes import facing, resampled
from streamlod.core.initialise.stereo.sweep import DepthMap, neighbours, pair_geometry
from streamlod.core.initialise.views import WorkingViews, pixel_centres

_AGREEMENT = 0.3  # weight, where views are asked to agree, of two pixels between a view's surface and another's
_BESIDE = 2.0  # pixels of parallax at which a depth is compared with a nearer and a farther one
_CHANGE = 0.1  # of the depth, tried in the first pass of the first round; half of it in the next pass, or round
_COUNTED = 2  # sources whose costs are averaged (patch_kernel.py)
_LEAST_ROWS = 120  # of pictures that are halved
_AROUND = 1.02  # factor by which depths may lie outside the bounds


@dataclass(frozen=True, slots=True)
class _Round:
    """One round over all views.

    Attributes:
        passes: over each picture.
        halved: whether pictures have half of their width and height, a quarter of the work.
        agreement: weight of two pixels between a view's surface and another's; 0 where pictures decide alone.
        change: halvings of the first change that is tried.
    """

    passes: int
    halved: bool
    agreement: float
    change: int


_ROUNDS = (
    _Round(4, True, 0.0, 0),
    _Round(1, False, 0.0, 1),  # without it, views come to agree on what only small pictures could not tell from it
    _Round(2, False, _AGREEMENT, 2),
    _Round(2, False, _AGREEMENT, 2),
)


@dataclass(frozen=True, slots=True, eq=False)
class SlantedMap(DepthMap):
    """Depth by slanted windows; `cost` is that of the pictures alone.

    Attributes:
        planes: [H,W,3] float64 inverse depth, and by how much it grows a pixel to the right and a pixel down.
        margin: [H,W] float32, how much more a depth beside a pixel's own costs, the cheaper one of the two sides: about
            none where a window has no texture, since it matches everywhere; below none where no depth can be told.
    """

    planes: Float64
    margin: Float32

    def normals(self) -> Float64:
        """[H*W,3] unit normals of the planes in the world, away from the camera, row by row."""
        centres, planes = pixel_centres(self.camera), self.planes.reshape(-1, 3)
        at_corner = planes[:, 0] - (centres * planes[:, 1:]).sum(axis=1)  # inverse depth, were the plane seen there
        normals = np.column_stack([planes[:, 1:], at_corner]) @ self.camera.intrinsics
        world = normals @ self.camera.world_to_camera[:3, :3]
        return np.asarray(world / np.linalg.norm(world, axis=1, keepdims=True), np.float64)

    def certain(self, least_margin: float) -> DepthMap:
        """The same depths, which cost `UNSEEN` where the margin is less than `least_margin`."""
        return DepthMap(self.camera, self.depth, np.where(self.margin < least_margin, np.float32(UNSEEN), self.cost))


def slanted(
    views: WorkingViews,
    maps: Sequence[DepthMap],
    bounds: tuple[float, float],
    progress: Callable[[float], None] = lambda _: None,
) -> list[SlantedMap]:
    """`maps` of `views` with better depths.

    Args:
        bounds: (near, far) depth in world units.
        progress: called with the fraction done.
    """
    limits = 1 / bounds[1] / _AROUND, 1 / bounds[0] * _AROUND
    rows = views.size[1]
    small = views.resized(rows // 2) if rows >= _LEAST_ROWS else views
    planes = [facing(depth_map.depth, limits) for depth_map in maps]
    for number, each in enumerate(_ROUNDS):
        pictures = small if each.halved else views
        planes = [resampled(plane, pictures.size, limits) for plane in planes]
        _improve(pictures, planes, limits, each, seed=10 * number)
        progress((1 + number) / len(_ROUNDS))
    weights = [_weights(image) for image in views.images]
    held = [plane[..., 0] for plane in planes]
    return [
        _judged(depth_map.camera, _pairs(views, index, weights[index], held), planes[index], limits[1])
        for index, depth_map in enumerate(maps)
    ]


def _improve(
    views: WorkingViews, planes: Sequence[Float64], limits: tuple[float, float], each: _Round, seed: int
) -> None:
    """The round `each` over all views, which changes their `planes`."""
    held = [plane[..., 0].copy() for plane in planes]
    for index, plane in enumerate(planes):
        pairs = _pairs(views, index, _weights(views.images[index]), held)
        cost = np.empty(plane.shape[:2], np.float32)
        plane_costs(pairs, each.agreement, plane, cost)
        for turn in range(each.passes):
            change = _CHANGE * 0.5 ** (turn + each.change)
            for parity in (0, 1):
                improve(pairs, each.agreement, *limits, change, parity, turn + seed, plane, cost)


def _weights(image: Float32) -> Float32:
    weights = np.empty((*image.shape[:2], SAMPLES), np.float32)
    window_weights(image, weights)
    return weights


def _pairs(views: WorkingViews, index: int, weights: Float32, held: list[Float64]) -> Pairs:
    """View `index` with its neighbours, which hold inverse depths `held` [H,W]."""
    camera, sources = views.cameras[index], neighbours(views, index)
    there = [pair_geometry(camera, views.cameras[source]) for source in sources]
    back = [pair_geometry(views.cameras[source], camera) for source in sources]
    (rays, shifts), (back_rays, back_shifts) = (
        (np.stack([pair[0] for pair in pairs]), np.stack([pair[1] for pair in pairs])) for pairs in (there, back)
    )
    inverse = np.stack([held[source] for source in sources])
    return Pairs(views.images[index], weights, views.images[sources], rays, shifts, back_rays, back_shifts, inverse)


def _judged(camera: Camera, pairs: Pairs, planes: Float64, nearest: float) -> SlantedMap:
    """`planes` with what they and those beside them cost by the pictures alone.

    Args:
        nearest: largest inverse depth of the search.
    """
    cost, beside = (np.empty(planes.shape[:2], np.float32) for _ in range(2))
    margin = np.full(cost.shape, np.inf, np.float32)
    plane_costs(pairs, 0.0, planes, cost)
    shift = np.sort(np.linalg.norm(pairs.shifts, axis=1))[:_COUNTED][-1]
    if shift * nearest < _BESIDE:  # cameras in one place: no depth moves anything in the picture
        margin[:] = -UNSEEN
    else:
        for side in (-_BESIDE, _BESIDE):
            plane_costs(pairs, 0.0, planes + np.array([side / shift, 0.0, 0.0]), beside)
            margin = np.minimum(margin, beside - cost)
    return SlantedMap(camera, np.asarray(1 / planes[..., 0], np.float32), cost, planes, margin)
