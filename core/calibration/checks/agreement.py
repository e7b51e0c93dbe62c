"""Agreement of cameras about what they share, by their poses.

Every two and three cameras that share features agree with each other or not. The pose that does not hold is that of the
camera with the most disagreements, less its agreements. Two cameras that agree count nothing against three that do not,
as two cannot see errors along their epipolar lines.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.checks.matches import PairMatches, residual
from streamlod.core.calibration.checks.triples import Agreement, agreements_of_three
from streamlod.core.camera import Camera

OFF = 3.0  # pixels at a width of 1000, beyond which poses do not hold


def agreements(pairs: Sequence[PairMatches], cameras: Sequence[Camera]) -> list[Agreement]:
    """The agreements of all two and three cameras that share enough."""
    twos = []
    for pair in pairs:
        two = pair.first, pair.second
        twos.append(Agreement(two, residual(pair, cameras[pair.first], cameras[pair.second]), two))
    return twos + agreements_of_three(pairs, cameras)


def misses(agreed: Sequence[Agreement], count: int) -> Float64:
    """[count] the smallest miss of each camera: among threes that judge it, else among twos; NaN without any."""
    best = np.full(count, np.nan)
    for number in range(count):
        found = [each for each in agreed if number in each.told]
        twos, threes = ([each.miss for each in found if len(each.cameras) == size] for size in (2, 3))
        best[number] = min(threes or twos, default=np.nan)
    return best


def suspects(agreed: Sequence[Agreement], count: int) -> Iterator[list[int]]:
    """Cameras whose poses do not hold, one by one, or several of which it is one."""
    left = list(agreed)
    while (scores := _scores(left, count)).max(initial=0) > 0:
        worst = np.flatnonzero(scores == scores.max()).tolist()
        rests = {number: [each for each in left if number not in each.cameras] for number in worst}
        after = {number: _scores(rest, count).max(initial=0) for number, rest in rests.items()}
        best = min(worst, key=lambda number: after[number])
        left = rests[best]
        yield [number for number in worst if after[number] <= 0] or [best]


def _scores(agreed: Sequence[Agreement], count: int) -> Float64:
    """[count] disagreements of each camera, less its agreements."""
    against, for_it = np.zeros((4, count)), np.zeros((4, count))  # by how many they are
    for each in agreed:
        if each.miss > OFF:
            against[len(each.cameras), list(each.cameras)] += 1
        else:
            for_it[len(each.cameras), list(each.told)] += 1
    threes = against[3] - for_it[3]
    twos = np.where(threes > 0, against[2], np.maximum(0, against[2] - for_it[2]))
    return np.asarray(threes + twos, np.float64)
