"""The instants at which a rig takes pictures: a grid in time, one period apart."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

_SECOND_NS = 1_000_000_000
MIN_RATE, MAX_RATE = 0.01, 1000.0  # instants a second of a rig
_STEADY = 0.25  # of a period
_USUAL = 0.01  # how far a usual rate may be from the measured one


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
        periods, period = (capture_ns - self.anchor_ns) * self.period_ns.denominator, self.period_ns.numerator
        return self.anchor + (2 * periods + period) // (2 * period)  # in integers, as there are many pictures

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


def rate_of(times_ns: Sequence[int], declared: Fraction) -> float:
    """Pictures a second of a camera that may have lost some.

    The declared rate, or a usual one, is taken where the times show it: measured from a short or coarse clock, a rate
    would be a little off.

    Args:
        times_ns: ascending times of pictures.
        declared: what the file says.
    """
    steps = [after - before for before, after in pairwise(times_ns) if after > before]
    if not steps:
        return float(declared)
    period = float(sorted(steps)[len(steps) // 4])  # lost pictures make steps longer only: many short ones are left
    single = [step for step in steps if step < 1.5 * period]
    period = sum(single) / len(single)  # or one short step would make a long gap one picture longer
    for _ in range(3):
        period = sum(steps) / sum(max(1, round(step / period)) for step in steps)
    measured = _SECOND_NS / period
    if not MIN_RATE <= measured <= MAX_RATE:
        return measured
    usual = [float(declared), round(measured), round(measured * 1.001) / 1.001]
    periods = (times_ns[-1] - times_ns[0]) / period
    near = [rate for rate in usual if abs(rate / measured - 1) < max(_USUAL, _STEADY / periods)]
    return next((rate for rate in near if is_steady(times_ns, rate)), measured)


def is_steady(times_ns: Sequence[int], fps: float) -> bool:
    """Whether all times lie within a quarter of a period of a grid of this rate, from the first one."""
    period = float(period_of(fps))
    return all(abs(part - round(part)) <= _STEADY for time in times_ns if (part := (time - times_ns[0]) / period))
