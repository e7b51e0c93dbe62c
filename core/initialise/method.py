"""A method of finding first points, and what it is given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from streamlod.core.camera import Camera
from streamlod.core.errors import InputError
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.initialise.bounds import estimate_bounds
from streamlod.core.initialise.views import WorkingViews, working_views


@dataclass(frozen=True, slots=True, eq=False)
class PointSources:
    """One instant of a recording, and what is known of the scene.

    Attributes:
        frame: the pictures; cameras that are not present are left out.
        cameras: [C] pinholes, in the order of the pictures and of their size.
        depth_bounds: (near, far) in world units, None where nobody has said.
        dataset_points: what the data set itself has, None for nothing.
        seed: of whatever is random.
        progress: to be called with the fraction done, from 0 to 1.
    """

    frame: FrameSet
    cameras: Sequence[Camera]
    depth_bounds: tuple[float, float] | None
    dataset_points: PointCloud | None
    seed: int
    progress: Callable[[float], None]

    def views(self, height: int) -> WorkingViews:
        """The cameras that delivered, with pictures of at most `height` rows."""
        return working_views(self.frame, self.cameras, height)

    def bounds(self, views: WorkingViews) -> tuple[float, float]:
        """(near, far) as known, or as estimated from `views`.

        Raises:
            InputError: nothing is known, and one camera alone gives no depth.
        """
        if self.depth_bounds is not None:
            return self.depth_bounds
        if len(views) < 2:
            raise InputError("first points", "one camera alone gives no depth: name a points file or depth bounds")
        return estimate_bounds(views)


Method = Callable[[PointSources], PointCloud]
"""Points to start from, possibly none. Raises InputError where the pictures cannot be used in this way, and
BackendUnavailable where a package that the method needs is not installed."""
