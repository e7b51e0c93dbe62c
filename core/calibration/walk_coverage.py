"""Coverage of a board walk: what each camera has seen of the board so far, and what it still needs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.csgraph import connected_components

from streamlod.core.arrays import Float64, Int64
from streamlod.core.calibration.track import MIN_CORNERS
from streamlod.core.data.names import spoken

QUARTERS = ("upper left", "upper right", "lower left", "lower right")  # of a picture
_ENOUGH = 4  # instants in which the board was in a quarter of a picture
_BESIDE = "with another camera"
_TOGETHER = 6  # instants in which two cameras saw it, before their poses hold together


@dataclass(frozen=True, slots=True, eq=False)
class WalkCoverage:
    """The coverage of C cameras by the board.

    Attributes:
        cameras: names.
        quarters: [C,4] instants in which some of the board was in a quarter of the picture.
        together: [C,C] instants in which both cameras saw the board; on the diagonal, those in which one did.
    """

    cameras: tuple[str, ...]
    quarters: Int64
    together: Int64

    @classmethod
    def none(cls, cameras: Sequence[str]) -> WalkCoverage:
        """Nothing seen yet."""
        return cls(tuple(cameras), np.zeros((len(cameras), 4), np.int64), np.zeros((len(cameras),) * 2, np.int64))

    def after(self, corners: Sequence[Float64]) -> WalkCoverage:
        """The coverage with one more instant.

        Args:
            corners: [J,2] for each camera, from (0, 0) to (1, 1) across its picture; NaN where not seen.
        """
        known = [each[np.isfinite(each).all(axis=1)] for each in corners]
        seen = np.array([is_seen(each) for each in corners], np.int64)
        quarters = self.quarters.copy()
        for camera in np.flatnonzero(seen):
            right, low = (known[camera] >= 0.5).T.astype(np.int64)
            quarters[camera, np.unique(2 * low + right)] += 1
        return replace(self, quarters=quarters, together=self.together + np.outer(seen, seen))

    @property
    def begun(self) -> bool:
        """Whether any camera has seen the board."""
        return bool(self.together.any())

    def needs(self) -> Iterator[str]:
        """Sentences about what is to be shown to whom; none once all have seen enough."""
        for name, times, quarters in zip(self.cameras, self.together.diagonal(), self.quarters, strict=True):
            lacking = _lacking(quarters)
            if not times:
                yield f"{name} has not seen it"
            elif lacking:
                where = "everywhere" if len(lacking) == len(QUARTERS) else f"in the {spoken(lacking, 4)}"
                yield f"{name} needs it {where}"
        if alone := self._alone():
            together = spoken([*(self.cameras[row] for row in alone), "another camera"], 5)
            yield f"{together} need it at one time"

    def next_needs(self) -> list[str]:
        """Words on what each camera needs next; "" of those that have seen enough."""
        alone, times = self._alone(), self.together.diagonal()
        return [
            "not seen yet" if not times[row] else next(iter(_lacking(quarters)), _BESIDE if row in alone else "")
            for row, quarters in enumerate(self.quarters)
        ]

    def _alone(self) -> list[int]:
        """The cameras, of those that saw the board with no others, that saw it the least; none if all hang together."""
        groups = connected_components(self.together >= _TOGETHER, directed=False)[1]
        if not groups.any():
            return []
        seldom = np.bincount(groups, self.together.diagonal()).argmin()
        return [int(row) for row in np.flatnonzero(groups == seldom)]


def is_seen(corners: Float64) -> bool:
    """Whether enough of [J,2] corners, NaN where not seen, are known to count the board as seen."""
    return int(np.isfinite(corners).all(axis=1).sum()) >= MIN_CORNERS


def _lacking(quarters: Int64) -> list[str]:
    return [quarter for quarter, count in zip(QUARTERS, quarters, strict=True) if count < _ENOUGH]
