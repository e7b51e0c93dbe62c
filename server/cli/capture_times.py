"""The word of `check` on a live rig's capture times."""

from __future__ import annotations

from streamlod.core.calibration.checks.finding import RigFinding, fault, weak
from streamlod.server.ingest.statistics import Statistics


def judged_times(told: Statistics, fps: float) -> list[RigFinding]:
    """Cameras whose times are wrong, so that their pictures are left out, or may be off by more than half a frame."""
    wrong = "{}: its {}: restart it and set its clock (NTP); of a phone, reload its page. Its pictures are left out"
    coarse = "{}: its capture times may be off by {:.0f} ms, more than half a frame; they rest on {} (docs/ingest.md)"
    faults = [
        fault(wrong.format(name, one.time_fault.words))
        for name, one in told.cameras.items()
        if one.time_fault is not None
    ]
    return faults + [
        weak(coarse.format(name, one.error_ns / 1e6, one.clock_source))
        for name, one in told.cameras.items()
        if one.time_fault is None and one.error_ns > 0.5e9 / fps
    ]
