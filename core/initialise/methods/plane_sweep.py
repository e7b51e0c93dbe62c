"""Points of depth maps that a plane sweep finds and several views confirm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from core.errors import InputError
from core.frames import PointCloud
from core.initialise.bounds import COARSE_HEIGHT, COARSE_PLANES, geometric_bounds, narrowed
from core.initialise.consistency import Trust, consistent_points
from core.initialise.equalise import equalised, with_equal_means
from core.initialise.method import PointSources
from core.initialise.sweep import plane_count, sweep_views
from core.initialise.views import WorkingViews


@dataclass(frozen=True, slots=True)
class PlaneSweep:
    """Sweeps coarsely to learn how deep the scene is and how exposures differ, then finely.

    Attributes:
        rows: of the pictures in which depth is measured.
        most_planes: inverse depths tried; more only where neighbouring views are far apart and something is near.
        trust: which pixels are believed.
    """

    rows: int = 160
    most_planes: int = 384
    trust: Trust = field(default_factory=Trust)

    def find(self, sources: PointSources) -> PointCloud:
        """Points by plane sweep and cross-view consistency.

        Raises:
            InputError: fewer than two views, or a rig that cannot measure depth.
        """
        return self.sweep(sources.views(self.rows), sources.depth_bounds, sources.progress)

    def sweep(
        self, views: WorkingViews, depth_bounds: tuple[float, float] | None, progress: Callable[[float], None]
    ) -> PointCloud:
        """`find`, of pictures of the working size."""
        if len(views) < 2:
            raise InputError("plane sweep", "needs pictures of at least two cameras; use a points file or random")
        widest = depth_bounds or geometric_bounds(views.cameras)
        coarse = views.resized(COARSE_HEIGHT)
        first = sweep_views(with_equal_means(coarse), widest, COARSE_PLANES)
        bounds = depth_bounds or narrowed(widest, first)
        even = equalised(views, coarse, first)
        maps = sweep_views(even, bounds, plane_count(even, bounds, self.most_planes), progress)
        return consistent_points(replace(even, images=views.images), maps, self.trust)


METHODS = {"sweep": PlaneSweep()}
