"""Several methods after one another: what most recordings are best served by."""

from __future__ import annotations

import logging

import numpy as np

from streamlod.core.frames import PointCloud
from streamlod.core.initialise.completion import completed, share_of_gaps
from streamlod.core.initialise.method import PointSources
from streamlod.core.initialise.methods.dataset import dataset_points
from streamlod.core.initialise.methods.learned import learned_sweep
from streamlod.core.initialise.methods.plane_sweep import plane_sweep
from streamlod.core.initialise.methods.random import random_points

_FEW = 500  # points; fewer are no start
_ROWS, _PIXELS = 45, 3  # of the pictures in which gaps are counted and filled: at most, and of the whole ones in each
_MOSTLY = 0.5  # of a picture
_log = logging.getLogger(__name__)


def colmap_and_sweep(sources: PointSources) -> PointCloud:
    """The points of the data set, then those of a plane sweep."""
    return merged(dataset_points(sources), plane_sweep(sources))


def automatic(sources: PointSources) -> PointCloud:
    """The data set's points with those that pictures give; where both are few, random ones as well.

    Where most of what cameras see is seen by one alone, so that nothing was found there, it is filled.
    """
    points = sources.dataset_points or PointCloud(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32))
    several = sources.frame.present.sum() > 1
    if several:
        points = merged(points, learned_sweep(sources))
    if len(points) < _FEW:
        doubt = "; are the cameras where their poses say? `streamlod check` tells" if several else ""
        _log.warning("the pictures gave only %d first points%s", len(points), doubt)
        points = merged(points, random_points(sources))
    views = sources.views(min(_ROWS, max(1, sources.frame.images.shape[1] // _PIXELS)))
    return completed(points, views, alone=True) if share_of_gaps(points, views) > _MOSTLY else points


def merged(first: PointCloud, second: PointCloud) -> PointCloud:
    """The points of both clouds."""
    return PointCloud(
        np.concatenate([first.positions, second.positions]), np.concatenate([first.colours, second.colours])
    )


METHODS = {"auto": automatic, "colmap+sweep": colmap_and_sweep}
