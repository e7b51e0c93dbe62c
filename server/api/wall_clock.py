"""Times of day in addresses: which recorded groups of pictures lie between two of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated

from fastapi import Depends, Query

from server.http.problems import Problem
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


def _time_range(
    begin: Annotated[datetime | None, Query(alias="from", description="RFC 3339 time, inclusive")] = None,
    end: Annotated[datetime | None, Query(alias="to", description="RFC 3339 time, exclusive")] = None,
) -> TimeRange:
    found = TimeRange(_nanoseconds(begin), _nanoseconds(end))
    if found.begin_ns is not None and found.end_ns is not None and found.end_ns <= found.begin_ns:
        raise Problem(422, "`to` must be later than `from`")
    return found


def _nanoseconds(time: datetime | None) -> int | None:
    if time is None:
        return None
    try:
        known = time if time.tzinfo is not None else time.replace(tzinfo=UTC)
        return int(known.timestamp() * 1e6) * 1000
    except (OverflowError, ValueError) as error:
        raise Problem(422, "a time is out of range") from error


WallClock = Annotated[TimeRange, Depends(_time_range)]
