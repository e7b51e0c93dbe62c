"""Which recorded groups of pictures lie between two times of day."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from server.stream.store import Segment


@dataclass(frozen=True, slots=True)
class TimeRange:
    """From one Unix time to another, in nanoseconds; None where that side is open."""

    begin_ns: int | None = None
    end_ns: int | None = None

    @property
    def is_open(self) -> bool:
        """Whether every time lies in it."""
        return self.begin_ns is None and self.end_ns is None

    def choose(self, segments: Sequence[Segment]) -> list[Segment]:
        """Those of a recording's segments of which some part lies in the range; one lasts until the next begins."""
        ends = [*(segment.begun_ns for segment in segments[1:]), None]
        return [
            segment
            for segment, end in zip(segments, ends, strict=False)
            if (self.end_ns is None or segment.begun_ns < self.end_ns)
            and (self.begin_ns is None or end is None or end > self.begin_ns)
        ]
