"""Points of the depths that a network believes: many more than pass every test, where few cameras film a room."""

from __future__ import annotations

from dataclasses import dataclass, field

from core.arrays import Bool
from core.frames import PointCloud
from core.initialise.confidence import usual_confidence
from core.initialise.consistency import points_of
from core.initialise.evidence import Matches, evidence
from core.initialise.method import PointSources
from core.initialise.methods.combined import Automatic
from core.initialise.methods.plane_sweep import PlaneSweep
from core.initialise.patch_kernel import UNSEEN

_FEWEST = 3  # views that the network has learnt from


@dataclass(frozen=True, slots=True)
class LearnedSweep:
    """The depths of a plane sweep and slanted windows, of which a network says how likely they are right.

    Attributes:
        sweep: finds them; its tests are cues among others, and decide where there are only two views.
        least_confidence: smallest probability with which a pixel becomes a point.
    """

    sweep: PlaneSweep = field(default_factory=PlaneSweep)
    least_confidence: float = 0.65

    def find(self, sources: PointSources) -> PointCloud:
        """Points of believed depths.

        Raises:
            InputError: as `PlaneSweep.find`.
        """
        views = sources.views(self.sweep.rows)
        matches = self.sweep.matches(views, sources.depth_bounds, sources.progress)
        return points_of(views, matches.maps, self.believed(matches))

    def believed(self, matches: Matches) -> list[Bool]:
        """V times [H,W], pixels whose depth is taken for right."""
        if len(matches.views) < _FEWEST:
            return list(matches.trusted)
        confidence = usual_confidence()
        return [
            (confidence(cues) > self.least_confidence).reshape(depth_map.depth.shape) & (depth_map.margin > -UNSEEN)
            for cues, depth_map in zip(evidence(matches), matches.maps, strict=True)
        ]


METHODS = {"learned": Automatic(sweep=LearnedSweep())}
