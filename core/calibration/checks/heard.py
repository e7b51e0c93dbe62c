"""Whether cameras are at one time, by what several of them heard."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from statistics import median_low

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.checks.finding import RigFinding, fact, weak
from streamlod.core.calibration.sound.alike import WAY, heard_offsets
from streamlod.core.data.names import spoken

_REACH = 0.8  # seconds either way that are searched


def judged(
    rising: Mapping[str, Float64],
    fps: float,
    remedy: Callable[[float], str] = lambda _: "walk the board again",
    reach: float = _REACH,
) -> Iterator[RigFinding]:
    """Findings about cameras that hear at another time than most; none where fewer than two heard the same.

    Args:
        rising: by camera, `rises` of its sound on the clock by which pictures are paired.
        fps: pictures a second.
        remedy: what to do about a camera that hears so many seconds later.
        reach: seconds either way that are searched.
    """
    off = _heard_off(rising, reach)
    for name, seconds in off.items():
        if abs(seconds) > 0.5 / fps + WAY:
            yield weak(
                f"{name} hears the same {1000 * abs(seconds):.0f} ms {'later' if seconds > 0 else 'earlier'} than most "
                f"cameras, so its pictures are {abs(seconds) * fps:.1f} frames off: {remedy(seconds)}"
            )
    if off:
        yield fact(_summary(list(off), max(abs(each) for each in off.values()), fps))


def _heard_off(rising: Mapping[str, Float64], reach: float) -> dict[str, float]:
    """Seconds by which each camera hears later than most what several of them heard; none for the others."""
    later = -heard_offsets(list(rising.values()), reach)
    known = {name: float(each) for name, each in zip(rising, later, strict=True) if np.isfinite(each)}
    middle = median_low(known.values()) if known else 0.0
    return {name: each - middle for name, each in known.items()}


def _summary(names: Sequence[str], most: float, fps: float) -> str:
    return (
        f"by what {spoken(names)} heard, their times agree to {1000 * most:.0f} ms, {most * fps:.1f} frames; "
        "sound takes 3 ms a metre"
    )
