"""Brings cameras to one exposure, by the colours of what two of them see.

Means over whole pictures do not tell exposures apart from content: cameras that look at different parts of a plain room
differ by more than a wall differs from what lies before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.initialise.consistency import Trust, trusted
from streamlod.core.initialise.stereo.sweep import DepthMap
from streamlod.core.initialise.views import WorkingViews, inside, project

_DARKEST, _BRIGHTEST = 0.05, 0.95  # colours between these say something about a gain
_COARSE = Trust(cost_by_one=0.6)  # exposures differ as yet, which costs
_ENOUGH = 100  # matched pixels by which two cameras are compared


def with_equal_means(views: WorkingViews) -> WorkingViews:
    """`views` with the mean of each channel brought to that of all views: a first guess, before anything is matched."""
    means = views.images.mean(axis=(1, 2), keepdims=True)
    return replace(views, images=views.images * (means.mean(axis=0) / np.maximum(means, 1e-3)))


def equalised(views: WorkingViews, seen: WorkingViews, maps: Sequence[DepthMap]) -> WorkingViews:
    """`views` with the gain a channel of each camera that makes matched pixels agree.

    Args:
        seen: the same views at the size of `maps`.
        maps: depth of each view; only trusted pixels are compared.
    """
    gains = np.exp(_log_gains(seen, maps))
    return replace(views, images=np.asarray(views.images * gains[:, None, None], np.float32))


def _log_gains(views: WorkingViews, maps: Sequence[DepthMap]) -> Float64:
    """[V,3] logarithms of the gains, zero on average: least squares over the medians of all pairs of cameras."""
    count = len(views)
    normal, right = 1e-3 * np.eye(count), np.zeros((count, 3))
    for one, depth_map in enumerate(maps):
        world = depth_map.points()
        good = trusted(world, one, maps, _COARSE)
        for other, camera in enumerate(views.cameras):
            if other == one:
                continue
            pixels, depth = project(camera, world)
            seen = np.flatnonzero(good & inside(camera, pixels, depth))
            column, row = pixels[seen].astype(np.int64).T
            agrees = np.abs(maps[other].depth[row, column] - depth[seen]) < _COARSE.tolerance * depth[seen]
            mine = views.images[one].reshape(-1, 3)[seen[agrees]]
            theirs = views.images[other][row[agrees], column[agrees]]
            usable = ((np.minimum(mine, theirs) > _DARKEST) & (np.maximum(mine, theirs) < _BRIGHTEST)).all(axis=1)
            if usable.sum() < _ENOUGH:
                continue
            ratio = np.median(np.log(mine[usable] / theirs[usable]), axis=0)
            normal[np.ix_([one, other], [one, other])] += [[1, -1], [-1, 1]]
            right[one] -= ratio
            right[other] += ratio
    gains = np.linalg.solve(normal, right)
    return np.asarray(gains - gains.mean(axis=0), np.float64)
