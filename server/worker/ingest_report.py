"""A worker's report on live cameras, as sentences."""

from __future__ import annotations

from typing import Any

from streamlod.server.ingest.sync.camera_track import CameraState
from streamlod.server.ingest.sync.time_fault import TimeFault

_SILENT_NS = 5_000_000_000  # of a camera whose connection stands: on a busy machine pictures stay away for seconds


def complaint(figures: dict[str, Any]) -> str:
    """Sentences about cameras that deliver nothing usable, or whose times or poses are wrong; empty where all is well.

    Args:
        figures: `server.ingest.statistics.Statistics` in JSON, as `Tag.INGEST` has them.
    """
    cameras = figures["cameras"]
    lost = {name: one["fault"] for name, one in cameras.items() if _is_missed(one)}
    parts = [
        f"camera {name} {one['refused']}" for name, one in cameras.items() if name not in lost and one.get("refused")
    ]
    parts += [
        f"camera {name} was knocked: put it back or calibrate again; until then the stream goes on without it"
        for name, one in cameras.items()
        if name not in lost and one.get("knocked")
    ]
    parts += [
        f"camera {name}'s {fault.words}: {fault.remedy}; until then the stream goes on without it"
        for name, one in cameras.items()
        if name not in lost and one.get("time_fault") and (fault := TimeFault(one["time_fault"]))
    ]
    parts += figures.get("poses", ())
    if lost:
        faults = sorted({fault for fault in lost.values() if fault})
        which = f"camera {next(iter(lost))} is lost"
        if len(lost) > 1:
            which = f"{len(lost)} of {len(cameras)} cameras are lost: {', '.join(lost)}"
        parts.insert(0, which + (f" ({'; '.join(faults)})" if faults else ""))
    return "; ".join(parts)


def _is_missed(camera: dict[str, Any]) -> bool:
    """Whether a camera is lost, and not merely silent for a moment."""
    silent_ns = camera["silent_ns"]
    is_silent = silent_ns is None or silent_ns >= _SILENT_NS
    return camera["state"] == CameraState.LOST and (camera["fault"] != "" or is_silent)


def sound_fault(figures: dict[str, Any]) -> str:
    """Why nothing is heard, in a sentence; empty where there is sound, or none is wanted. Pictures go on without."""
    fault = figures.get("sound")
    return fault if isinstance(fault, str) else ""
