"""Random points in the space that the cameras share."""

from __future__ import annotations

from dataclasses import dataclass

from streamlod.core.frames import PointCloud
from streamlod.core.initialise.method import PointSources
from streamlod.core.initialise.scatter import random_points


@dataclass(frozen=True, slots=True)
class RandomPoints:
    """Points spread evenly in inverse depth.

    Attributes:
        rows: of the pictures from which colours and bounds are taken.
    """

    rows: int = 160

    def find(self, sources: PointSources) -> PointCloud:
        """Points within the depth bounds."""
        views = sources.views(self.rows)
        return random_points(views, sources.bounds(views), sources.seed)


METHODS = {"random": RandomPoints()}
