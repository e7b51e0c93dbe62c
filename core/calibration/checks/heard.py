"""Whether cameras are at one time, by what several of them heard."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
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
    later = -heard_offsets(list(rising.values()), reach)
    known = {name: float(each) for name, each in zip(rising, later, strict=True) if np.isfinite(each)}
    if not known:
        return
    middle = median_low(known.values())
    off = {name: each - middle for name, each in known.items()}
    for name, seconds in off.items():
        if abs(seconds) > 0.5 / fps + WAY:
            yield weak(
                f"{name} hears the same {1000 * abs(seconds):.0f} ms {'later' if seconds > 0 else 'earlier'} than most "
                f"cameras, so its pictures are {abs(seconds) * fps:.1f} frames off: {remedy(seconds)}"
            )
    most = max(abs(each) for each in off.values())
    yield fact(
        f"by what {spoken(off)} heard, their times agree to {1000 * most:.0f} ms, {most * fps:.1f} frames; "
        "sound takes 3 ms a metre"
    )
