"""Counts what damage costs a video file."""

from __future__ import annotations

import logging
from collections.abc import Iterable

from streamlod.core.data.names import listed

_log = logging.getLogger(__name__)
_SECOND_NS = 1_000_000_000
_MAX_TOLD = 5


class Damage:
    """The pictures of one pass through a file that damage costs.

    Attributes:
        awaited: times in nanoseconds of samples whose pictures have not been shown yet.
    """

    def __init__(self) -> None:
        self.awaited: list[int] = []
        self._begins: list[int] = []
        self._lost = 0
        self._hurt = False

    def happen(self) -> None:
        """Note that from here on, pictures are lost until the next one that is shown."""
        self._hurt = True

    def show(self, time_ns: int) -> None:
        """Note that a picture is shown, so that those awaited before it are lost, if there was damage."""
        self._lose(time for time in self.awaited if time < time_ns)
        self.awaited = [time for time in self.awaited if time > time_ns]

    def tell(self, name: str) -> None:
        """Log what was lost, in one sentence."""
        self._lose(self.awaited)
        if self._begins:
            times = listed((f"{time_ns / _SECOND_NS:.3f} s" for time_ns in self._begins), _MAX_TOLD)
            fault = "%s: is damaged at %s; up to the next keyframe, %d of its pictures are left out"
            _log.warning(fault, name, times, self._lost)

    def _lose(self, times: Iterable[int]) -> None:
        if self._hurt and (gone := sorted(times)):
            self._begins.append(gone[0])
            self._lost += len(gone)
            self._hurt = False
