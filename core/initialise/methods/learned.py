"""Points of depths that pass every test, and where these leave gaps, of depths that a network believes.

The tests lose most of what is near, plain or seen at a slant; few cameras see the gap from another side.
"""

from __future__ import annotations

from streamlod.core.arrays import Bool
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.confidence.evidence import Matches, evidence
from streamlod.core.initialise.confidence.gaps import in_gaps
from streamlod.core.initialise.confidence.network import usual_confidence
from streamlod.core.initialise.confidence.witness import SAME
from streamlod.core.initialise.consistency import knowing, points_of, votes
from streamlod.core.initialise.method import PointSources
from streamlod.core.initialise.methods.plane_sweep import ROWS, swept
from streamlod.core.initialise.stereo.patch_kernel import UNSEEN

LEAST_CONFIDENCE = 0.65  # smallest probability with which a pixel in a gap becomes a point
_FEWEST = 3  # views that the network has learnt from
_ROUNDS = 2  # what only confirms others must be confirmed itself


def learned_sweep(sources: PointSources) -> PointCloud:
    """Points of believed depths of a plane sweep.

    Raises:
        InputError: as `plane_sweep`.
    """
    views = sources.views(ROWS)
    matches = swept(views, sources.depth_bounds, sources.progress)
    return points_of(views, matches.maps, believed(matches))


def believed(matches: Matches, least_confidence: float = LEAST_CONFIDENCE) -> list[Bool]:
    """V times [H,W], pixels whose depth is taken for right: those that pass the tests, and where there are more than
    two views, those in gaps that a network believes.
    """
    if len(matches.views) < _FEWEST:
        return list(matches.trusted)
    confidence, gaps = usual_confidence(), in_gaps(matches.maps, matches.trusted)
    likely = [
        (confidence(cues) > least_confidence).reshape(depth_map.depth.shape) & (depth_map.margin > -UNSEEN)
        for cues, depth_map in zip(evidence(matches), matches.maps, strict=True)
    ]
    good = [sure | (belief & gap) for sure, belief, gap in zip(matches.trusted, likely, gaps, strict=True)]
    for _ in range(_ROUNDS):
        good = _confirmed(matches, good)
    return good


def _confirmed(matches: Matches, believed: list[Bool]) -> list[Bool]:
    """Which `believed` pixels remain: those that pass the tests, and those that more views confirm than look through.

    Only believed pixels of other views confirm or look through.
    """
    sure, found = knowing(matches.maps, believed), []
    for index, (depth_map, good, trusted) in enumerate(zip(matches.maps, believed, matches.trusted, strict=True)):
        agreeing, through = votes(depth_map.points(), index, sure, SAME)
        found.append(trusted | (good & (agreeing > through).reshape(good.shape)))
    return found


METHODS = {"learned": learned_sweep}
