"""Poses against what the cameras see: a camera that was knocked, or cameras whose names are exchanged.

Each two and three cameras that share features agree with each other or not. Whose pose does not hold is whom most
disagree with, less those who agree. Two that agree say nothing against three that do not, as they are blind along their
epipolar lines.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.checks.finding import RigFinding, fact, fault, weak
from streamlod.core.calibration.checks.matches import PairMatches, residual
from streamlod.core.calibration.checks.triples import triple_misses
from streamlod.core.camera import Camera

_OFF = 3.0  # pixels at a width of 1000, beyond which poses do not hold
_BETTER = 0.5
_ELSEWHERE = 30.0  # pixels at a width of 1000, from which a picture may well be another camera's


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


def judged(
    agreed: Sequence[Agreement], pairs: Sequence[PairMatches], cameras: Sequence[Camera]
) -> Iterator[RigFinding]:
    """Findings about cameras whose poses do not hold."""
    names = [camera.name for camera in cameras]
    seen = {number for each in agreed for number in each.cameras}
    for number in sorted(set(range(len(cameras))) - seen):
        yield weak(f"{names[number]} shares too little with other cameras to check its pose")
    told = {number for each in agreed if len(each.cameras) == 3 for number in each.told}
    if blind := ", ".join(names[number] for number in sorted(seen - told)):
        yield fact(f"of {blind} a turn to the side would not be seen: too little is shared with two others at once")
    groups = list(_suspects(agreed, len(cameras)))
    off = sorted({number for group in groups for number in group})
    if len(off) > 1 and (pair := _exchanged(agreed, pairs, cameras, off)) is not None:
        a, b = (names[number] for number in pair)
        yield fault(f"{a} and {b} are exchanged: each shows what the other's pose sees; swap their names")
        return
    if len(off) == len(seen) > 0 and (len(off) == 2 or len(groups) > 1):
        yield fault(
            f"no camera's pose holds (matches lie {_among(agreed, off):.1f} pixels off at a width of "
            "1000): the calibration is of another rig, or cameras have moved; calibrate again"
        )
        return
    for group in groups:
        miss, again = _among(agreed, group), "calibrate again"
        if miss > _ELSEWHERE:
            again = "put the names right if another camera filmed this, else calibrate again"
        lies = f"lies {miss:.1f} pixels (at a width of 1000) from where"
        if len(group) == 1:
            yield fault(f"{names[group[0]]} was knocked or turned: what it sees {lies} its pose puts it; {again}")
        else:
            some = f"{', '.join(names[number] for number in group[:-1])} and {names[group[-1]]}"
            yield fault(f"one of {some} was knocked or turned: what they see {lies} their poses put it; {again}")


def _suspects(agreed: Sequence[Agreement], count: int) -> Iterator[list[int]]:
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
        if each.miss > _OFF:
            against[len(each.cameras), list(each.cameras)] += 1
        else:
            for_it[len(each.cameras), list(each.told)] += 1
    threes = against[3] - for_it[3]
    twos = np.where(threes > 0, against[2], np.maximum(0, against[2] - for_it[2]))
    return np.asarray(threes + twos, np.float64)


def _among(agreed: Sequence[Agreement], numbers: Sequence[int]) -> float:
    """Median miss of agreements with one of these cameras that do not hold."""
    found = [each.miss for each in agreed if each.miss > _OFF and not set(numbers).isdisjoint(each.cameras)]
    return float(np.median(found))


def _exchanged(
    agreed: Sequence[Agreement], pairs: Sequence[PairMatches], cameras: Sequence[Camera], off: list[int]
) -> tuple[int, int] | None:
    """Two cameras with which exchanged all poses hold."""
    options = []
    for a, b in combinations(off, 2):
        swapped = list(cameras)
        swapped[a], swapped[b] = swapped[b], swapped[a]
        options.append((_middle(agreements(pairs, swapped), off), a, b))
    after, a, b = min(options)
    return (a, b) if after < _BETTER * _middle(agreed, off) and after < _OFF else None


def _middle(agreed: Sequence[Agreement], off: Sequence[int]) -> float:
    found = [each.miss for each in agreed if not set(off).isdisjoint(each.cameras)]
    return float(np.median(found))
