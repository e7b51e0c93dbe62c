"""Faults of the times of one camera's pictures, told once they have lasted."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from streamlod.server.ingest.sync.picture import Picture

_LASTING_NS = 2_000_000_000  # less is a step of a clock, or a connection that stalled


class TimeFault(StrEnum):
    """still, back: times that do not advance; far: from those of the other cameras."""

    STILL = "still"
    BACK = "back"
    FAR = "far"

    @property
    def words(self) -> str:
        """The words for it in a sentence, after the name of a camera."""
        return _WORDS[self]

    @property
    def remedy(self) -> str:
        """The words for what puts it right."""
        return "set its clock (NTP)" if self is TimeFault.FAR else "restart it"


_WORDS = {
    TimeFault.STILL: "times stand still",
    TimeFault.BACK: "times run backwards",
    TimeFault.FAR: "times are far from those of the other cameras",
}


@dataclass(slots=True)
class TimeWatch:
    """A watch on the times of one camera's pictures, in the order of their arrival."""

    _capture_ns: int | None = None  # of the newest picture
    _fault: TimeFault | None = None
    _since_ns: int = 0  # when the first of the wrong ones in a row came
    _newest_ns: int = 0  # when the last one came

    def note(self, picture: Picture, now_ns: int, *, is_far: bool) -> None:
        """Look at a picture that has come; `is_far` where its time is impossible beside those of the other cameras."""
        last, self._capture_ns = self._capture_ns, picture.capture_ns
        found: TimeFault | None = None
        if last is not None and picture.capture_ns <= last:
            found = TimeFault.STILL if picture.capture_ns == last else TimeFault.BACK
        elif is_far:
            found = TimeFault.FAR
        if self._fault is None:
            self._since_ns = now_ns
        self._fault, self._newest_ns = found, now_ns

    def fault(self) -> TimeFault | None:
        """The fault, if all pictures of two seconds had wrong times."""
        return self._fault if self._newest_ns - self._since_ns >= _LASTING_NS else None
