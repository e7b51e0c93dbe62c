"""Points from depth that a VGGT model predicts."""

from __future__ import annotations

from dataclasses import dataclass

from core.frames import PointCloud
from core.initialise.method import PointSources
from core.initialise.vggt import vggt_points


@dataclass(frozen=True, slots=True)
class VggtPoints:
    """Predicted depth, placed into the known cameras.

    Attributes:
        rows: of the pictures that the model is given.
    """

    rows: int = 518

    def find(self, sources: PointSources) -> PointCloud:
        """Points on which the placed depth maps agree."""
        return vggt_points(sources.views(self.rows))


METHODS = {"vggt": VggtPoints()}
