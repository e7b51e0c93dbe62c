"""Sentences of a calibration's report on what cameras heard."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median_low

import numpy as np

from streamlod.core.calibration.solve import Calibration
from streamlod.core.calibration.sound.alike import WAY
from streamlod.core.data.names import spoken


def sound_advice(calibration: Calibration) -> Iterator[str]:
    """Which offsets rest on sound, and how far sound and board are apart where both tell; none without sound."""
    names = [camera.name for camera in calibration.cameras]
    if calibration.by_sound.any():
        which = spoken(name for name, by_sound in zip(names, calibration.by_sound, strict=True) if by_sound)
        yield (
            f"{which}: the offset is that of sound, good to 3 ms a metre, as the board was held still or seen too "
            "shortly to tell it; walk the board where other cameras see it too to know it better"
        )
    off = calibration.heard - calibration.offsets
    both = np.flatnonzero(np.isfinite(off) & ~calibration.by_sound)
    if len(both) < 2:
        return
    off = off - median_low(off[both])
    for number in both:
        seconds, period = float(off[number]), float(calibration.periods[number])
        if abs(seconds) > period / 2 + WAY:
            yield (
                f"{names[number]}: sound puts its clock {1000 * abs(seconds):.0f} ms, {abs(seconds) / period:.1f} "
                f"frames, {'later' if seconds > 0 else 'earlier'} than the board does, whose offset is used: its sound "
                "was recorded beside its pictures' time, as phones may do, or the walk is wrong; if what moves has "
                "ghosts, walk the board again"
            )
    most = max(both, key=lambda number: abs(off[number]))
    frames = abs(off[most]) / calibration.periods[most]
    yield (
        f"by what {spoken(names[number] for number in both)} heard, their offsets are the board's to "
        f"{1000 * abs(off[most]):.0f} ms, {frames:.1f} frames; the board's are used, as sound takes 3 ms a metre"
    )
