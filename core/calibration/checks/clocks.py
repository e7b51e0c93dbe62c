"""Clocks of recorded cameras: rates, lost pictures, and times that stand still."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from streamlod.core.calibration.checks.finding import RigFinding, fault, weak
from streamlod.core.calibration.walk import WalkFootage

_LOST = 0.02  # part of the pictures
_DRIFT = 0.5  # periods that a camera may lose against the others over the recording
_UNEVEN = 0.25  # of a period


@dataclass(frozen=True, slots=True)
class Clock:
    """One camera's times.

    Attributes:
        camera: name. rate: pictures a second where it is not interrupted.
        lost: part of its pictures that are missing between the first and the last.
        uneven: standard deviation of its times from an even beat, in periods.
        begin, end: seconds of the first and the last picture.
    """

    camera: str
    rate: float
    lost: float
    uneven: float
    begin: float
    end: float


def clock_of(footage: WalkFootage) -> Clock:
    """The clock of a camera with at least two pictures."""
    times = footage.times
    steps = np.diff(times)
    period = float(np.median(steps))
    counts = np.maximum(1, np.round(steps / max(period, 1e-9)))
    beats = np.concatenate([[0.0], np.cumsum(counts)])
    line = np.polyfit(beats, times, 1)
    rest = times - np.polyval(line, beats)
    rate = 1 / max(float(line[0]), 1e-9)
    lost = 1 - len(times) / (counts.sum() + 1)
    return Clock(footage.camera, rate, float(lost), float(rest.std() * rate), float(times[0]), float(times[-1]))


def judged(clocks: Sequence[Clock]) -> Iterator[RigFinding]:
    """Findings about clocks that do not go with the others.

    An uneven clock's pictures cannot be counted exactly: gaps of one and a half periods are one or two. So nothing is
    said of its drift, and where any clock is even, the others are compared with the even ones alone.
    """
    even = [clock for clock in clocks if clock.uneven <= _UNEVEN]
    rate = float(np.median([clock.rate for clock in even or clocks]))
    end = float(np.median([clock.end for clock in clocks]))
    for clock in clocks:
        seconds = clock.end - clock.begin
        if clock.end < end - max(1.0, 3 / rate):
            yield fault(
                f"{clock.camera} ends {end - clock.end:.1f} s before most cameras: its clock or its recording stopped"
            )
        if clock.lost > _LOST:
            yield weak(
                f"{clock.camera} lost {100 * clock.lost:.0f} % of its pictures: record to a faster "
                "card, or stream at a lower rate"
            )
        ratio = clock.rate / rate
        multiple = max(ratio, 1 / ratio)
        if abs(multiple - round(multiple)) > 0.01:
            yield fault(
                f"{clock.camera} runs at {clock.rate:.2f} pictures a second, most cameras at "
                f"{rate:.2f}: set them to one rate"
            )
        elif clock in even and (drift := abs(multiple / round(multiple) - 1) * seconds * rate) > _DRIFT:
            yield weak(
                f"{clock.camera} drifts by {drift:.1f} pictures against most cameras within "
                f"{seconds:.0f} s: use cameras that are set by NTP, or cut the recording shorter"
            )
        if clock.uneven > _UNEVEN:
            yield weak(
                f"{clock.camera} takes its pictures unevenly ({clock.uneven:.2f} of a period): "
                "switch its variable rate off"
            )
