"""Evidence for and against the depth of a pixel: how it matches, and what other views and its neighbours say.

All of it is free of world units, so that a room and a stadium look alike. Texture, windows and parallax are in pixels
of the working size; the network has learnt from pictures of 135 to 160 rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import uniform_filter

from streamlod.core.arrays import Bool, Float32, Float64
from streamlod.core.initialise.confidence.witness import MARGINS, SAME, WITNESSES, Surfaces, surfaces, witness
from streamlod.core.initialise.consistency import pieces
from streamlod.core.initialise.stereo.patches import SlantedMap
from streamlod.core.initialise.stereo.sweep import DepthMap, neighbours
from streamlod.core.initialise.views import WorkingViews

CUES = (
    "cost", "margin", "cost of the sweep", "difference to the sweep",
    "least difference to a view", "cosine between normals there", "cost there", "margin there",
    "views that agree", "views that agree in normal too", "views that see it", "views that look through",
    "views that look through at trusted pixels", "neighbours with agreement", "second plane residual",
    "third plane residual", "trusted neighbours", "size of the piece", "depth", "texture",
    "cosine of the viewing angle", "parallax",
)  # fmt: skip
_MOST = 0.2  # relative difference beyond which it does not matter how much
_LIKE = 0.9  # cosine of normals that agree
_MANY = 4.0  # views; more say no more
_STEP = 3  # pixels to the neighbours that a plane is compared with


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Depths, and what is known of them, of V views of one size.

    Attributes:
        views: V cameras and their pictures.
        maps: V depth maps of slanted windows; facing: V of windows that face the camera.
        trusted: V times [H,W], pixels that pass the tests of `consistency.py`.
    """

    views: WorkingViews
    maps: Sequence[SlantedMap]
    facing: Sequence[DepthMap]
    trusted: Sequence[Bool]


def evidence(matches: Matches) -> list[Float32]:
    """For each view [H*W, len(CUES)], row by row."""
    held = [surfaces(*pair) for pair in zip(matches.maps, matches.trusted, strict=True)]
    usual = float(np.median(np.concatenate([m.depth[good] for m, good in _any_trusted(matches)])))
    return [_of_view(matches, index, held, usual) for index in range(len(matches.maps))]


def _any_trusted(matches: Matches) -> list[tuple[SlantedMap, Bool]]:
    """Depth maps with their trusted pixels, with all pixels where none is trusted."""
    pairs = list(zip(matches.maps, matches.trusted, strict=True))
    return pairs if any(good.any() for _, good in pairs) else [(m, np.ones_like(good)) for m, good in pairs]


def _of_view(matches: Matches, index: int, held: Sequence[Surfaces], usual: float) -> Float32:
    mine, facing, normals = matches.maps[index], matches.facing[index], held[index].normals
    shape, points = mine.depth.shape, mine.points()
    witnesses = [witness(held[other], points, normals) for other in neighbours(matches.views, index, WITNESSES)]
    difference = np.stack([witness.difference for witness in witnesses])
    best = difference.argmin(axis=0)[None]

    def there(name: str) -> Float64:
        found = np.stack([getattr(witness, name) for witness in witnesses])
        return np.asarray(np.take_along_axis(found, best, axis=0)[0], np.float64)

    def count(truth: Sequence[Bool]) -> Float64:
        return np.asarray(np.minimum(np.sum(truth, axis=0), _MANY), np.float64)

    agree: Bool = np.asarray((difference < SAME).any(axis=0)).reshape(shape)
    away = points - mine.camera.centre
    residual = _plane_residuals(mine.planes)
    cues = (
        mine.cost, np.clip(mine.margin, *MARGINS),
        facing.cost, np.minimum(np.abs(mine.depth / facing.depth - 1), _MOST),
        np.minimum(difference.min(axis=0), _MOST), there("cosine"), there("cost"), there("margin"),
        count([w.difference < SAME for w in witnesses]),
        count([(w.difference < SAME) & (w.cosine > _LIKE) for w in witnesses]),
        count([w.sees for w in witnesses]), count([w.through for w in witnesses]),
        count([w.through_trusted for w in witnesses]),
        uniform_filter(agree.astype(np.float32), 7), residual[1], residual[2],
        uniform_filter(matches.trusted[index].astype(np.float32), 15), _piece_share(mine.depth, agree),
        np.log(mine.depth / usual), _texture(matches.views.images[index]),
        np.abs((normals * away).sum(axis=1)) / np.linalg.norm(away, axis=1),
        np.log(_parallax(matches.views, index) / mine.depth),
    )  # fmt: skip
    return np.stack([np.asarray(cue, np.float32).ravel() for cue in cues], axis=1)


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
    piece = pieces(depth, agree, SAME)
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
