"""What speaks for and against the depth of a pixel: how it matches, and what other views and its neighbours say.

All of it is free of world units, so that a room and a stadium look alike. Texture, windows and parallax are in pixels
of the working size; the network has learnt from pictures of 135 to 160 rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import minimum_filter, uniform_filter

from core.arrays import Bool, Float32, Float64
from core.initialise.consistency import pieces
from core.initialise.patches import SlantedMap
from core.initialise.sweep import DepthMap, neighbours
from core.initialise.views import WorkingViews, inside, project

CUES = (
    "cost", "margin", "cost of the sweep", "difference to the sweep",
    "least difference to a view", "cosine between normals there", "cost there", "margin there",
    "views that agree", "views that agree in normal too", "views that see it", "views that look through",
    "views that look through at trusted pixels", "neighbours with agreement", "second plane residual",
    "third plane residual", "trusted neighbours", "size of the piece", "depth", "texture",
    "cosine of the viewing angle", "parallax",
)  # fmt: skip
_SAME = 0.02  # relative difference of depths that agree
_MOST = 0.2  # relative difference beyond which it does not matter how much
_LIKE = 0.9  # cosine of normals that agree
_WITNESSES = 7  # nearest views, as many as the network has learnt from: by chance, one of many agrees with anything
_MANY = 4.0  # views; more say no more
_STEP = 3  # pixels to the neighbours that a plane is compared with
_UNSEEN_COST, _UNSEEN_COSINE = 3.0, -1.0  # where a view does not see the point: as bad as can be, or worse
_MARGINS = -0.5, 1.0  # beyond them a margin says no more


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """What is known of V views of one size.

    Attributes:
        views: V cameras and their pictures.
        maps: V depth maps of slanted windows; facing: V of windows that face the camera.
        trusted: V times [H,W], pixels that pass the tests of `consistency.py`.
    """

    views: WorkingViews
    maps: Sequence[SlantedMap]
    facing: Sequence[DepthMap]
    trusted: Sequence[Bool]


@dataclass(frozen=True, slots=True, eq=False)
class _Surfaces:
    """What a view holds, for others to ask.

    Attributes:
        depth_map: of the view. normals: [H*W,3] of its planes.
        nearest: [H,W] least depth of 3x3 pixels. nearest_trusted: of those trusted, infinite where none is.
    """

    depth_map: SlantedMap
    normals: Float64
    nearest: Float32
    nearest_trusted: Float32


@dataclass(frozen=True, slots=True, eq=False)
class _Witness:
    """What one other view says of N points: each [N].

    Attributes:
        sees: the point lies in its picture.
        difference: relative, of its depth there; infinite where it does not see the point.
        cosine: of the two normals. cost: of the pixel there. margin: of that pixel, within `_MARGINS`.
        through: it sees only farther things there. through_trusted: and trusted pixels say so.
    """

    sees: Bool
    difference: Float64
    cosine: Float64
    cost: Float64
    margin: Float64
    through: Bool
    through_trusted: Bool


def evidence(matches: Matches) -> list[Float32]:
    """For each view [H*W, len(CUES)], row by row."""
    surfaces = [_surfaces(*pair) for pair in zip(matches.maps, matches.trusted, strict=True)]
    usual = float(np.median(np.concatenate([m.depth[good] for m, good in _any_trusted(matches)])))
    return [_of_view(matches, index, surfaces, usual) for index in range(len(matches.maps))]


def _surfaces(depth_map: SlantedMap, trusted: Bool) -> _Surfaces:
    sure = np.where(trusted, depth_map.depth, np.float32(np.inf))
    return _Surfaces(depth_map, depth_map.normals(), minimum_filter(depth_map.depth, 3), minimum_filter(sure, 3))


def _any_trusted(matches: Matches) -> list[tuple[SlantedMap, Bool]]:
    """Depth maps with their trusted pixels, with all pixels where none is trusted."""
    pairs = list(zip(matches.maps, matches.trusted, strict=True))
    return pairs if any(good.any() for _, good in pairs) else [(m, np.ones_like(good)) for m, good in pairs]


def _of_view(matches: Matches, index: int, surfaces: Sequence[_Surfaces], usual: float) -> Float32:
    mine, facing, normals = matches.maps[index], matches.facing[index], surfaces[index].normals
    shape, points = mine.depth.shape, mine.points()
    witnesses = [_witness(surfaces[other], points, normals) for other in _nearest(matches.views, index)]
    difference = np.stack([witness.difference for witness in witnesses])
    best = difference.argmin(axis=0)[None]

    def there(name: str) -> Float64:
        found = np.stack([getattr(witness, name) for witness in witnesses])
        return np.asarray(np.take_along_axis(found, best, axis=0)[0], np.float64)

    def count(truth: Sequence[Bool]) -> Float64:
        return np.asarray(np.minimum(np.sum(truth, axis=0), _MANY), np.float64)

    agree: Bool = np.asarray((difference < _SAME).any(axis=0)).reshape(shape)
    away = points - mine.camera.centre
    residual = _plane_residuals(mine.planes)
    cues = (
        mine.cost, np.clip(mine.margin, *_MARGINS),
        facing.cost, np.minimum(np.abs(mine.depth / facing.depth - 1), _MOST),
        np.minimum(difference.min(axis=0), _MOST), there("cosine"), there("cost"), there("margin"),
        count([w.difference < _SAME for w in witnesses]),
        count([(w.difference < _SAME) & (w.cosine > _LIKE) for w in witnesses]),
        count([w.sees for w in witnesses]), count([w.through for w in witnesses]),
        count([w.through_trusted for w in witnesses]),
        uniform_filter(agree.astype(np.float32), 7), residual[1], residual[2],
        uniform_filter(matches.trusted[index].astype(np.float32), 15), _piece_share(mine.depth, agree),
        np.log(mine.depth / usual), _texture(matches.views.images[index]),
        np.abs((normals * away).sum(axis=1)) / np.linalg.norm(away, axis=1),
        np.log(_parallax(matches.views, index) / mine.depth),
    )  # fmt: skip
    return np.stack([np.asarray(cue, np.float32).ravel() for cue in cues], axis=1)


def _nearest(views: WorkingViews, index: int) -> list[int]:
    """The views that are asked about view `index`."""
    centres = np.stack([camera.centre for camera in views.cameras])
    order = np.argsort(np.linalg.norm(centres - centres[index], axis=1), kind="stable")
    return [int(other) for other in order if other != index][:_WITNESSES]


def _witness(other: _Surfaces, points: Float64, normals: Float64) -> _Witness:
    """What view `other` says of `points` [N,3] with `normals` [N,3]."""
    depth_map = other.depth_map
    pixels, depth = project(depth_map.camera, points)
    sees = inside(depth_map.camera, pixels, depth)
    column, row = np.where(sees[:, None], pixels, 0).astype(np.int64).T
    safe = np.where(sees, depth, 1.0)
    theirs = other.normals.reshape(*depth_map.depth.shape, 3)[row, column]
    nearest, sure = other.nearest[row, column], other.nearest_trusted[row, column]
    return _Witness(
        sees=sees,
        difference=np.where(sees, np.abs(depth_map.depth[row, column] / safe - 1), np.inf),
        cosine=np.where(sees, (normals * theirs).sum(axis=1), _UNSEEN_COSINE),
        cost=np.where(sees, depth_map.cost[row, column], _UNSEEN_COST),
        margin=np.clip(np.where(sees, depth_map.margin[row, column], _MARGINS[0]), *_MARGINS),
        through=sees & (depth < nearest * (1 - 2 * _SAME)),
        through_trusted=sees & np.isfinite(sure) & (depth < sure * (1 - 2 * _SAME)),
    )


def _plane_residuals(planes: Float64) -> Float64:
    """[4,H,W] in ascending order: by how much each of four neighbours lies off the pixel's own plane, relatively."""
    found = []
    for down, right in ((0, _STEP), (0, -_STEP), (_STEP, 0), (-_STEP, 0)):
        pad = ((max(-down, 0), max(down, 0)), (max(-right, 0), max(right, 0)))
        height, width = planes.shape[:2]
        beside = np.pad(planes[..., 0], pad, mode="edge")[max(down, 0) :, max(right, 0) :][:height, :width]
        expected = planes[..., 0] + planes[..., 1] * right + planes[..., 2] * down
        found.append(np.minimum(np.abs(expected / beside - 1), _MOST))
    return np.sort(np.stack(found), axis=0)


def _piece_share(depth: Float32, agree: Bool) -> Float64:
    """[H*W] natural logarithm of the share of the picture that a pixel's connected piece of agreeing pixels covers."""
    piece = pieces(depth, agree, _SAME)
    size = np.bincount(piece, weights=agree.ravel())
    return np.log((1 + size[piece]) / depth.size)


def _texture(image: Float32) -> Float32:
    """[H,W] how much a picture [H,W,3] changes within some pixels."""
    detail = image - cv2.GaussianBlur(image, (0, 0), 2)
    return np.asarray(np.sqrt(cv2.GaussianBlur((detail**2).mean(axis=2), (0, 0), 2)), np.float32)


def _parallax(views: WorkingViews, index: int) -> float:
    """Pixels by which a point one unit away moves to the view that is second nearest."""
    camera = views.cameras[index]
    other = views.cameras[neighbours(views, index)[:2][-1]]
    return float(np.linalg.norm(other.centre - camera.centre) * camera.intrinsics[1, 1]) + 1e-9
