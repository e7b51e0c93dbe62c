"""Room on the disk for what an evening streams, as `check` tells it."""

from __future__ import annotations

import shutil

from streamlod.core.calibration.checks.finding import RigFinding, weak
from streamlod.core.files import nearest_folder
from streamlod.server.settings import Settings

# Four cameras of 640x360 on two cores streamed 70 MB an hour, mostly sound and keyframes; graphics cards make ten times
# as many frames.
_EVENING_BYTES = 1_000_000_000


def judged_room(settings: Settings) -> list[RigFinding]:
    """Findings about the disk of the server's recordings, whose room nobody would miss before the evening is over."""
    if settings.state is None:
        return []
    reserve = settings.retention.reserve_fraction
    usage = shutil.disk_usage(nearest_folder(settings.state))
    room = usage.free - reserve * usage.total
    if room >= min(_EVENING_BYTES, settings.retention.bytes):
        return []
    has = f"has {room / 1e6:.0f} MB for what is streamed" if room > 0 else "is full, so that nothing streamed is kept"
    beyond = f", beyond the {100 * reserve:.3g} % that recordings leave free" if reserve else ""
    return [weak(f"the disk of {settings.state} {has}{beyond}; make room, or name another folder as `state`")]
