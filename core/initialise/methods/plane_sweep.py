"""Points of depth maps that a plane sweep begins, slanted windows refine, and several views confirm."""

from __future__ import annotations

from collections.abc import Callable

from streamlod.core.errors import InputError
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.bounds import COARSE_HEIGHT, COARSE_PLANES, geometric_bounds, narrowed, rig_width
from streamlod.core.initialise.confidence.evidence import Matches
from streamlod.core.initialise.consistency import Trust, confirmed, points_of, trusted_pixels
from streamlod.core.initialise.equalise import equalised, with_equal_means
from streamlod.core.initialise.method import PointSources
from streamlod.core.initialise.stereo.patches import slanted
from streamlod.core.initialise.stereo.sweep import plane_count, sweep_views
from streamlod.core.initialise.views import WorkingViews

ROWS = 160  # of the pictures in which depth is measured
_MOST_PLANES = 384  # inverse depths tried; more only where neighbouring views are far apart and something is near
_TRUST_SLANTED = Trust(tolerance=0.02, cost_by_one=0.8, cost_by_more=1.0, smallest_piece=0.004)
"""Which pixels of slanted windows are believed in any case; others only where the sweep's are trusted, too."""
_LEAST_MARGIN = 0.02  # by which a depth of slanted windows must be better than those beside it to be believed
_SWEEP_SHARE = 0.4  # of the time


def plane_sweep(sources: PointSources) -> PointCloud:
    """Points by plane sweep and cross-view consistency.

    Raises:
        InputError: fewer than two views, or a rig that cannot measure depth.
    """
    views = sources.views(ROWS)
    matches = swept(views, sources.depth_bounds, sources.progress)
    return points_of(views, matches.maps, matches.trusted)


def swept(
    views: WorkingViews,
    depth_bounds: tuple[float, float] | None,
    progress: Callable[[float], None] = lambda _: None,
) -> Matches:
    """Depths of all pixels of `views`, right or wrong, and which of them the tests of `consistency.py` let pass.

    Sweeps coarsely to learn how deep the scene is and how exposures differ, then finely, then slants the windows.

    Raises:
        InputError: as `plane_sweep`.
    """
    if len(views) < 2:
        raise InputError("plane sweep", "needs pictures of at least two cameras; use a points file or random")
    rig_width(views.cameras)  # must not be zero
    widest = depth_bounds or geometric_bounds(views.cameras)
    coarse = views.resized(COARSE_HEIGHT)
    first = sweep_views(with_equal_means(coarse), widest, COARSE_PLANES)
    bounds = depth_bounds or narrowed(widest, first)
    even = equalised(views, coarse, first)
    planes = plane_count(even, bounds, _MOST_PLANES)
    facing = sweep_views(even, bounds, planes, lambda done: progress(_SWEEP_SHARE * done))
    maps = slanted(even, facing, bounds, lambda done: progress(_SWEEP_SHARE + (1 - _SWEEP_SHARE) * done))
    certain = [depth_map.certain(_LEAST_MARGIN) for depth_map in maps]
    alone, either = trusted_pixels(certain, _TRUST_SLANTED), confirmed(certain, facing, Trust())
    trusted = [one | other for one, other in zip(alone, either, strict=True)]
    return Matches(even, maps, facing, trusted)


METHODS = {"sweep": plane_sweep}
