"""The instants at which a rig takes pictures: a grid in time, one period apart."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

_SECOND_NS = 1_000_000_000


def period_of(fps: float) -> Fraction:
    """Nanoseconds between instants; 29.97 is taken for 30000/1001, as television's rates are meant."""
    television = Fraction(round(fps * 1.001) * 1000, 1001)
    exact = television if abs(fps - television) < 1e-3 else Fraction(fps).limit_denominator(1000)
    return _SECOND_NS / exact


@dataclass(frozen=True, slots=True)
class Grid:
    """Slots numbered along a line of time.

    Attributes:
        period_ns: between instants.
        anchor: number of an instant.
        anchor_ns: its capture time.
    """

    period_ns: Fraction
    anchor: int
    anchor_ns: int

    def instant_of(self, capture_ns: int) -> int:
        """Number of the nearest instant."""
        return self.anchor + math.floor((capture_ns - self.anchor_ns) / self.period_ns + Fraction(1, 2))

    def time_of(self, number: int) -> int:
        """Capture time of an instant, to the nanosecond."""
        return self.anchor_ns + round((number - self.anchor) * self.period_ns)

    def turn_of(self, capture_ns: int) -> complex:
        """Where between two instants a time lies, as a point on the unit circle; 1 is on an instant."""
        return cmath.rect(1, 2 * math.pi * float((capture_ns - self.anchor_ns) % self.period_ns / self.period_ns))


def phase_of(turn: complex) -> float:
    """The part of a period in [-0.5, 0.5] that a point on the unit circle, or a mean of such points, stands for."""
    return cmath.phase(turn) / (2 * math.pi)


def best_phase(phases: Sequence[float]) -> float:
    """Where instants should lie, as a part of a period in (-0.5, 0.5], so that cameras of these phases are paired best.

    Instant boundaries go into the middle of the widest gap between the cameras' phases, so that jitter moves no picture
    over one.
    """
    ordered = sorted(phases)
    if not ordered:
        return 0.0
    ends = [*ordered[1:], ordered[0] + 1]
    gap, begin = max((round(end - begin, 6), begin) for begin, end in zip(ordered, ends, strict=True))
    centre = begin + gap / 2 + 0.5
    return centre - math.ceil(centre - 0.5)
