"""One camera as the synchroniser sees it: what became of its pictures, and how they come."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum

from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.time_fault import TimeWatch

_HELD = 8  # pictures of a camera kept until all cameras have come


class CameraState(StrEnum):
    """ok; late (delivers too late, or with wrong times); lost (delivers nothing)."""

    OK = "ok"
    LATE = "late"
    LOST = "lost"


@dataclass(slots=True)
class Counts:
    """Counts of one camera's pictures, by what became of them.

    Attributes:
        received: that came.
        late: that came after their instant had closed.
        duplicate: that shared an instant with a nearer one.
        stray: whose capture time is impossible.
        missing: instants that closed without one.
        skew_ns: smoothed difference between capture and instant time.
    """

    received: int = 0
    late: int = 0
    duplicate: int = 0
    stray: int = 0
    missing: int = 0
    skew_ns: int = 0


@dataclass(slots=True)
class CameraTrack:
    """One camera, as its pictures have come so far."""

    counts: Counts = field(default_factory=Counts)
    arrived_ns: int | None = None  # None: lost
    newest: int | None = None  # instant
    delay_ns: int = 0
    lag_ns: float = 0.0  # smoothed delay beyond the cameras' median
    strays: int = 0
    is_late: bool = False
    is_back: bool = False  # after a silence; what is known of its phase may hold no more
    turn: complex = 0
    times: TimeWatch = field(default_factory=TimeWatch)
    held: deque[Picture] = field(default_factory=lambda: deque(maxlen=_HELD))

    def state(self, now_ns: int, lost_ns: int) -> CameraState:
        """The camera's state; lost after a silence of `lost_ns`."""
        if self.arrived_ns is None or now_ns - self.arrived_ns > lost_ns:
            return CameraState.LOST
        return CameraState.LATE if self.is_late else CameraState.OK
