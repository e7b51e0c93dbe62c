"""A deadline for every frame: what does not fit before it is left out, so latency holds at the cost of quality.

The trainer asks before each stage whether it still fits, and during training how far the frame is. Costs are learnt
from earlier frames: a higher cost is taken over at once, a lower one gradually.
"""

from __future__ import annotations

import math
from collections.abc import Callable

_FORGET = 0.2  # weight of the latest frame in a cost that falls
_MAX_COST = 3.0  # budgets: one pause of seconds must not stop training for a hundred frames
_UNKNOWN = 0.05  # of the budget, reserved for a later stage that has never been timed
_MARGIN = 0.05  # of the budget, reserved for work that no stage accounts for


Pace = Callable[[int], float]
"""How far a frame's training is before step number n (from 0), which also says how far its learning rates have decayed:
in [0, 1]; 1 or more ends the training."""


def fixed_steps(steps: int) -> Pace:
    """A fixed number of steps."""
    return lambda step: step / steps if steps else 1.0


class FrameBudget:
    """Wall time for one frame, from its pictures to its packet.

    Args:
        milliseconds: for each frame, more than 0; None for as many as it takes.
        clock: seconds, from any origin.
    """

    def __init__(self, milliseconds: float | None, clock: Callable[[], float]) -> None:
        self._seconds, self._clock = math.inf if milliseconds is None else milliseconds / 1000, clock
        self._costs: dict[str, float] = {}
        self._end = clock() + self._seconds

    @property
    def is_limited(self) -> bool:
        """Whether there is a deadline."""
        return self._seconds < math.inf

    def start(self) -> None:
        """The frame's pictures are here."""
        self._end = self._clock() + self._seconds

    def spent(self, stage: str, seconds: float) -> None:
        """Learn that `stage` of the latest frame took so long."""
        known, seconds = self._costs.get(stage, 0.0), min(seconds, _MAX_COST * self._seconds)
        self._costs[stage] = seconds if seconds > known else known + _FORGET * (seconds - known)

    def left(self, *later: str) -> float:
        """Seconds until the deadline, less what the stages `later` will take; negative when it is too late."""
        if not self.is_limited:
            return math.inf
        reserved = sum(self._costs.get(stage, _UNKNOWN * self._seconds) for stage in later)
        return self._end - self._clock() - reserved - _MARGIN * self._seconds

    def allows(self, stage: str, *later: str) -> bool:
        """Whether `stage` can be afforded with the stages `later` still to come; one never tried can."""
        known = self._costs.get(stage, 0.0)
        if known <= self.left(*later):
            return True
        self._costs[stage] = (1 - _FORGET) * known  # so that it is tried again one day
        return False

    def pace(self, steps: int, *later: str) -> Pace:
        """A pace that ends after `steps`, or where the next step might take time that the stages `later` need."""
        by_steps, begin, allowed = fixed_steps(steps), self._clock(), self.left(*later)
        before, longest = begin, 0.0

        def progress(step: int) -> float:
            nonlocal before, longest
            now = self._clock()
            if step:
                longest = max(longest, now - before)
            before = now
            if self.left(*later) < longest or allowed <= 0:
                return 1.0
            return max(by_steps(step), (now - begin) / allowed)

        return progress
