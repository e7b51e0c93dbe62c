"""Testimony of other views on the points of one: whether they see them, hold them, or look through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import minimum_filter

from streamlod.core.arrays import Bool, Float32, Float64
from streamlod.core.initialise.stereo.patches import SlantedMap
from streamlod.core.initialise.views import inside, project

SAME = 0.02  # relative difference of depths that agree
MARGINS = -0.5, 1.0  # beyond them a margin says no more
WITNESSES = 7  # nearest views, as many as the network has learnt from: by chance, one of many agrees with anything
_UNSEEN_COST, _UNSEEN_COSINE = 3.0, -1.0  # where a view does not see the point: as bad as can be, or worse


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """A view that others ask.

    Attributes:
        depth_map: of the view. normals: [H*W,3] of its planes.
        nearest: [H,W] least depth of 3x3 pixels. nearest_trusted: of those trusted, infinite where none is.
    """

    depth_map: SlantedMap
    normals: Float64
    nearest: Float32
    nearest_trusted: Float32


@dataclass(frozen=True, slots=True, eq=False)
class Witness:
    """Testimony of one other view on N points: each [N].

    Attributes:
        sees: the point lies in its picture.
        difference: relative, of its depth there; infinite where it does not see the point.
        cosine: of the two normals. cost: of the pixel there. margin: of that pixel, within `MARGINS`.
        through: it sees only farther things there. through_trusted: and trusted pixels say so.
    """

    sees: Bool
    difference: Float64
    cosine: Float64
    cost: Float64
    margin: Float64
    through: Bool
    through_trusted: Bool


def surfaces(depth_map: SlantedMap, trusted: Bool) -> Surfaces:
    """A view of which the pixels `trusted` [H,W] pass the tests."""
    sure = np.where(trusted, depth_map.depth, np.float32(np.inf))
    return Surfaces(depth_map, depth_map.normals(), minimum_filter(depth_map.depth, 3), minimum_filter(sure, 3))


def witness(other: Surfaces, points: Float64, normals: Float64) -> Witness:
    """Testimony of view `other` on `points` [N,3] with `normals` [N,3]."""
    depth_map = other.depth_map
    pixels, depth = project(depth_map.camera, points)
    sees = inside(depth_map.camera, pixels, depth)
    column, row = np.where(sees[:, None], pixels, 0).astype(np.int64).T
    safe = np.where(sees, depth, 1.0)
    theirs = other.normals.reshape(*depth_map.depth.shape, 3)[row, column]
    nearest, sure = other.nearest[row, column], other.nearest_trusted[row, column]
    return Witness(
        sees=sees,
        difference=np.where(sees, np.abs(depth_map.depth[row, column] / safe - 1), np.inf),
        cosine=np.where(sees, (normals * theirs).sum(axis=1), _UNSEEN_COSINE),
        cost=np.where(sees, depth_map.cost[row, column], _UNSEEN_COST),
        margin=np.clip(np.where(sees, depth_map.margin[row, column], MARGINS[0]), *MARGINS),
        through=sees & (depth < nearest * (1 - 2 * SAME)),
        through_trusted=sees & np.isfinite(sure) & (depth < sure * (1 - 2 * SAME)),
    )
