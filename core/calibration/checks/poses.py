"""Findings about poses against what the cameras see: a knocked camera, or cameras whose names are exchanged."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from streamlod.core.calibration.checks.agreement import OFF, suspects
from streamlod.core.calibration.checks.exchange import Order, orders
from streamlod.core.calibration.checks.finding import RigFinding, fact, fault, weak
from streamlod.core.calibration.checks.matches import PairMatches
from streamlod.core.calibration.checks.triples import Agreement
from streamlod.core.data.lens import Undistortion
from streamlod.core.data.names import listed, spoken

_ELSEWHERE = 30.0  # pixels at a width of 1000, from which a picture may well be another camera's


def judged(
    agreed: Sequence[Agreement], pairs: Sequence[PairMatches], plans: Sequence[Undistortion]
) -> Iterator[RigFinding]:
    """Findings about cameras whose poses do not hold.

    Args:
        plans: what made the pictures of `pairs` fit the cameras that `agreed` tells of.
    """
    names = [plan.camera.name for plan in plans]
    seen = {number for each in agreed for number in each.cameras}
    for number in sorted(set(range(len(names))) - seen):
        yield weak(f"{names[number]} shares too little with other cameras to check its pose")
    told = {number for each in agreed if len(each.cameras) == 3 for number in each.told}
    if blind := spoken(names[number] for number in sorted(seen - told)):
        yield fact(f"of {blind} a turn to the side would not be seen: too little is shared with two others at once")
    groups = list(suspects(agreed, len(names)))
    off = sorted({number for group in groups for number in group})
    if off and (found := orders(pairs, plans)):
        yield fault("; or else ".join(_exchange(order, names) for order in found))
        return
    if len(off) == len(seen) > 0 and (len(off) == 2 or len(groups) > 1):
        yield fault(
            f"no camera's pose holds (matches lie {_among(agreed, off):.1f} pixels off at a width of "
            "1000): the calibration is of another rig, names are exchanged, or cameras have moved; calibrate again"
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
            some = spoken(names[number] for number in group)
            yield fault(f"one of {some} was knocked or turned: what they see {lies} their poses put it; {again}")


def _exchange(order: Order, names: Sequence[str]) -> str:
    moved = [number for number, camera in enumerate(order) if camera != number]
    some = spoken(names[number] for number in moved)
    if len(moved) == 2:
        return f"{some} are exchanged: swap their names, as each shows what the other's pose sees"
    right = listed(names[order[number]] for number in moved)
    return f"{some} are exchanged: they show what the poses of {right} see, in this order; name them so"


def _among(agreed: Sequence[Agreement], numbers: Sequence[int]) -> float:
    """Median miss of agreements with one of these cameras that do not hold."""
    found = [each.miss for each in agreed if each.miss > OFF and not set(numbers).isdisjoint(each.cameras)]
    return float(np.median(found))
