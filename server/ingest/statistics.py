"""Figures of a live rig and its cameras, for reports, the REST interface and metrics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from streamlod.core.data.names import spoken
from streamlod.server.ingest.sync.camera_track import CameraState, Counts
from streamlod.server.ingest.sync.clock import ClockSource
from streamlod.server.ingest.sync.pace import is_slow
from streamlod.server.ingest.sync.time_fault import TimeFault

SLOW = "{:.0f} a second, but the rig wants {:g} pictures: give more light, or write a lower fps into the rig's file"


@dataclass(frozen=True, slots=True)
class CameraStatistics:
    """How one camera does.

    Attributes:
        clock_source: evidence of its capture times; None before the first picture.
        error_ns: how far off they may be.
        drift_ppm: how much faster its clock runs than the wall's, in millionths.
        counts: of its pictures.
        connections: how often it was connected; of a camera that is pushed, how often somebody began to push it.
        fault: why it does not deliver; empty if it does.
        refused: why its newest picture could not be used for training; empty when it could.
        shift: how far what it sees has moved since it is read, in pixels at a width of 1000; None where not known.
        knocked: whether it was; then it is not trained on.
        silent_ns: how long no picture has come; None before the first, and after the camera has gone.
        time_fault: what has been wrong with its pictures' times for seconds; None where nothing is.
        size: width and height of its pictures.
        rate: pictures a second over its last seconds of filming; None where it has not filmed for long enough.
        trouble: what is wrong with it and what to do, in words after its name; empty where it films as it should.
    """

    state: CameraState
    clock_source: ClockSource | None
    error_ns: int
    drift_ppm: float
    counts: Counts
    connections: int
    fault: str
    refused: str = ""
    shift: float | None = None
    knocked: bool = False
    silent_ns: int | None = None
    time_fault: TimeFault | None = None
    size: tuple[int, int] | None = None
    rate: float | None = None
    trouble: str = ""

    def judged(self, complaint: str, fps: float | None) -> CameraStatistics:
        """The same with its `trouble`.

        Args:
            complaint: of its place or name, see `Findings.complaint`.
            fps: pictures a second that are wanted; None where any rate will do.
        """
        if self.state is CameraState.LOST:
            return replace(self, trouble=self.refused or self.fault or "no pictures come")
        times = "" if self.time_fault is None else f"its {self.time_fault.words}: {self.time_fault.remedy}"
        slow = "" if self.rate is None or fps is None or not is_slow(self.rate, fps) else SLOW.format(self.rate, fps)
        return replace(self, trouble=self.refused or times or complaint or slow)


@dataclass(frozen=True, slots=True)
class Statistics:
    """The whole rig.

    Attributes:
        degraded: whether some camera is lost.
        waiting: whether training waits for an instant.
        delivered: instants handed to training.
        dropped_stale: instants that training was too slow for.
        dropped_incomplete: instants with fewer cameras than the policy asks for.
        latency_ns: from capture to delivery, of the oldest picture in the newest instant delivered.
        clock_steps: times that the cameras' common clock was stepped.
        cameras: by name.
        sound: why nothing is heard, in a sentence; empty where there is sound; None where none is wanted.
        poses: a sentence about each fault of the cameras' poses, as far as what the cameras share tells.
    """

    degraded: bool
    waiting: bool
    delivered: int
    dropped_stale: int
    dropped_incomplete: int
    latency_ns: int
    clock_steps: int
    cameras: dict[str, CameraStatistics]
    sound: str | None = None
    poses: tuple[str, ...] = ()


def trouble_of(missing: Mapping[str, str]) -> str:
    """The cameras in `missing`, each with what is wrong with it, those with the same fault together."""
    faults = dict.fromkeys(missing.values())  # in their order; cameras of one fault are named together
    cameras = [spoken([name for name in missing if missing[name] == fault]) for fault in faults]
    return ", ".join(f"{names} ({fault or 'no pictures come'})" for names, fault in zip(cameras, faults, strict=True))
