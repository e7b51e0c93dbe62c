"""The word of `check` on a live rig's capture times."""

from __future__ import annotations

from streamlod.core.calibration.checks.finding import RigFinding, weak
from streamlod.server.ingest.statistics import Statistics


def judged_times(told: Statistics, fps: float) -> list[RigFinding]:
    """Cameras whose capture times may be off by more than half a frame."""
    sentence = "{}: its capture times may be off by {:.0f} ms, more than half a frame; they rest on {} (docs/ingest.md)"
    return [
        weak(sentence.format(name, one.error_ns / 1e6, one.clock_source))
        for name, one in told.cameras.items()
        if one.error_ns > 0.5e9 / fps
    ]
