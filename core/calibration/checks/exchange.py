"""Pictures under other cameras' names: orders of the names with which all poses hold.

A picture that was undistorted by another camera's lens has its points moved to where the lens of its own shows them.
The search exchanges two names at a time, as long as what each two cameras share comes nearer to the poses.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from streamlod.core.calibration.checks.agreement import OFF, agreements, suspects
from streamlod.core.calibration.checks.matches import MIN_MATCHES, PairMatches, residual
from streamlod.core.data.lens import Undistortion

_FEWEST = 2  # agreements that speak for it; a single one holds by chance
_TRIED = 3  # exchanges, the most likely ones
_LEAST, _MOST = 1.0, 300.0  # pixels at a width of 1000, beyond which misses tell no more

Order = tuple[int, ...]  # for each picture, the number of the camera that took it


def orders(pairs: Sequence[PairMatches], plans: Sequence[Undistortion]) -> list[Order]:
    """The orders with which no pose is off; none where an exchange does not explain what is seen.

    Args:
        pairs: matches of pictures in the order given. plans: of the cameras that they are said to be of.
    """
    search = _Search(pairs, plans)
    given = tuple(range(len(plans)))
    order = given
    while search.miss(better := min(search.exchanged(order), key=search.miss, default=order)) < search.miss(order):
        order = better
    single = sorted(search.exchanged(given), key=search.miss)[:_TRIED]
    found = [each for each in dict.fromkeys([order, *single]) if search.miss(each) < search.miss(given)]
    return [each for each in found if search.holds(each)]


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    pairs: Sequence[PairMatches]
    plans: Sequence[Undistortion]
    known: dict[tuple[int, int, int], float] = field(default_factory=dict)  # misses of pairs by numbers of cameras

    def exchanged(self, order: Order) -> Iterator[Order]:
        """The orders in which two names are exchanged, of cameras of one size that another disagrees with."""
        off = [pair for number, pair in enumerate(self.pairs) if self._of_pair(number, order) > OFF]
        for a, b in combinations(sorted({number for pair in off for number in (pair.first, pair.second)}), 2):
            one, other = (self.plans[order[number]].lens for number in (a, b))
            if (one.width, one.height) == (other.width, other.height):
                yield tuple(order[{a: b, b: a}.get(number, number)] for number in range(len(order)))

    def miss(self, order: Order) -> float:
        """The mean logarithm of the pairs' misses."""
        found = [self._of_pair(number, order) for number in range(len(self.pairs))]
        return float(np.log(np.clip(found, _LEAST, _MOST)).mean()) if found else 0.0

    def _of_pair(self, number: int, order: Order) -> float:
        pair = self.pairs[number]
        key = number, order[pair.first], order[pair.second]
        if key not in self.known:
            moved = self._moved(pair, order)
            cameras = (self.plans[each].camera for each in key[1:])
            self.known[key] = residual(moved, *cameras) if len(moved.points) >= MIN_MATCHES else _MOST
        return self.known[key]

    def holds(self, order: Order) -> bool:
        """Whether all poses hold, and enough speaks for those that were exchanged."""
        cameras = [self.plans[each].camera for each in order]
        moved = [each for pair in self.pairs if len((each := self._moved(pair, order)).points) >= MIN_MATCHES]
        agreed = agreements(moved, cameras)
        others = {number for number, each in enumerate(order) if number != each}
        touched = [each for each in agreed if not others.isdisjoint(each.cameras)]
        return len(touched) >= _FEWEST and not list(suspects(agreed, len(cameras)))

    def _moved(self, pair: PairMatches, order: Order) -> PairMatches:
        """The matches where the lenses of these cameras show them."""
        sides = [
            self.plans[name].as_by(self.plans[order[name]], found) if order[name] != name else found
            for name, found in zip((pair.first, pair.second), np.moveaxis(pair.points, 1, 0), strict=True)
        ]
        points = np.stack(sides, axis=1)
        seen = np.isfinite(points).all(axis=(1, 2))
        return replace(pair, points=points[seen], features=pair.features[seen])
