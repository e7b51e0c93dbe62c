"""Points of a coarse sweep alone, with the gaps filled: two seconds, for a picture until better ones are there."""

from __future__ import annotations

from streamlod.core.errors import InputError
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.bounds import geometric_bounds, narrowed
from streamlod.core.initialise.completion import completed
from streamlod.core.initialise.consistency import Trust, consistent_points
from streamlod.core.initialise.equalise import equalised, with_equal_means
from streamlod.core.initialise.method import PointSources
from streamlod.core.initialise.methods.combined import merged
from streamlod.core.initialise.stereo.sweep import sweep_views

_ROWS = 90  # of the pictures
_PLANES = 64  # inverse depths tried
_TRUST = Trust(tolerance=0.04, cost_by_one=0.6)  # a wrong depth costs little here, and none would cost a picture
_CELLS = 45  # rows of the grid in which gaps are filled


def coarse_sweep(sources: PointSources) -> PointCloud:
    """The data set's points, those of a sweep of small pictures, and what fills the gaps between them.

    Raises:
        InputError: fewer than two views, or a rig that cannot measure depth.
    """
    views = sources.views(_ROWS)
    if len(views) < 2:
        raise InputError("coarse sweep", "needs pictures of at least two cameras")
    widest = sources.depth_bounds or geometric_bounds(views.cameras)
    first = sweep_views(with_equal_means(views), widest, _PLANES)
    even = equalised(views, views, first)
    maps = sweep_views(even, sources.depth_bounds or narrowed(widest, first), _PLANES)
    points = consistent_points(even, maps, _TRUST)
    if sources.dataset_points is not None:
        points = merged(sources.dataset_points, points)
    return completed(points, sources.views(_CELLS))
