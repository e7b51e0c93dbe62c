"""Agreement of cameras about what they share, by their poses.

Each two and three cameras that share features agree with each other or not. Whose pose does not hold is whom most
disagree with, less those who agree. Two that agree say nothing against three that do not, as they are blind along their
epipolar lines.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.checks.matches import PairMatches, residual
from streamlod.core.calibration.checks.triples import triple_misses
from streamlod.core.camera import Camera

OFF = 3.0  # pixels at a width of 1000, beyond which poses do not hold


@dataclass(frozen=True, slots=True)
class Agreement:
    """How well two or three cameras agree.

    Attributes:
        cameras: their numbers. miss: pixels at a width of 1000.
        told: numbers of those for whom it speaks where it is small: of three, those that could not be turned unseen.
    """

    cameras: tuple[int, ...]
    miss: float
    told: tuple[int, ...]


def agreements(pairs: Sequence[PairMatches], cameras: Sequence[Camera]) -> list[Agreement]:
    """The agreements of all two and three cameras that share enough."""
    both = [(pair.first, pair.second) for pair in pairs]
    twos = [
        Agreement(two, residual(pair, *(cameras[number] for number in two)), two)
        for two, pair in zip(both, pairs, strict=True)
    ]
    threes = [Agreement(each.cameras, each.miss, each.judged) for each in triple_misses(pairs, cameras)]
    return twos + threes


def misses(agreed: Sequence[Agreement], count: int) -> Float64:
    """[count] the best miss of each camera: by threes that tell of it, else by twos; NaN without."""
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
    """[count] how many disagree with a camera, less those who agree."""
    against, for_it = np.zeros((4, count)), np.zeros((4, count))  # by how many they are
    for each in agreed:
        if each.miss > OFF:
            against[len(each.cameras), list(each.cameras)] += 1
        else:
            for_it[len(each.cameras), list(each.told)] += 1
    threes = against[3] - for_it[3]
    twos = np.where(threes > 0, against[2], np.maximum(0, against[2] - for_it[2]))
    return np.asarray(threes + twos, np.float64)
