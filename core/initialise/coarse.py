"""Points of a coarse sweep alone, with the gaps filled: two seconds, for a picture until better ones are there."""

from __future__ import annotations

from dataclasses import dataclass, field

from streamlod.core.errors import InputError
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.bounds import geometric_bounds, narrowed
from streamlod.core.initialise.completion import Completion
from streamlod.core.initialise.consistency import Trust, consistent_points
from streamlod.core.initialise.equalise import equalised, with_equal_means
from streamlod.core.initialise.method import PointSources
from streamlod.core.initialise.methods.combined import merged
from streamlod.core.initialise.stereo.sweep import sweep_views


@dataclass(frozen=True, slots=True)
class CoarseSweep:
    """The data set's points, those of a sweep of small pictures, and what fills the gaps between them.

    Attributes:
        rows: of the pictures. planes: inverse depths tried.
        trust: which pixels are believed; a wrong depth costs little here, and none would cost a picture.
    """

    rows: int = 90
    planes: int = 64
    trust: Trust = field(default_factory=lambda: Trust(tolerance=0.04, cost_by_one=0.6))
    completion: Completion = field(default_factory=lambda: Completion(shared=True))

    def find(self, sources: PointSources) -> PointCloud:
        """Points on whatever the pictures show, possibly none.

        Raises:
            InputError: fewer than two views, or a rig that cannot measure depth.
        """
        views = sources.views(self.rows)
        if len(views) < 2:
            raise InputError("coarse sweep", "needs pictures of at least two cameras")
        widest = sources.depth_bounds or geometric_bounds(views.cameras)
        first = sweep_views(with_equal_means(views), widest, self.planes)
        even = equalised(views, views, first)
        maps = sweep_views(even, sources.depth_bounds or narrowed(widest, first), self.planes)
        points = consistent_points(even, maps, self.trust)
        if sources.dataset_points is not None:
            points = merged(sources.dataset_points, points)
        return self.completion.completed(points, sources.views(self.completion.rows))
