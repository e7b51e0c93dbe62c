"""Which recorded groups of pictures lie between two times of day."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar


class _Timed(Protocol):
    @property
    def begun_ns(self) -> int | None:
        """Unix time of the group's keyframe, where it is recorded."""


_T = TypeVar("_T", bound=_Timed)


@dataclass(frozen=True, slots=True)
class TimeRange:
    """From one Unix time to another, in nanoseconds; None where that side is open."""

    begin_ns: int | None = None
    end_ns: int | None = None

    @property
    def is_open(self) -> bool:
        """Whether every time lies in it."""
        return self.begin_ns is None and self.end_ns is None

    def choose(self, groups: Sequence[_T]) -> list[_T]:
        """Recorded groups of which some part lies in the range; one lasts until the next begins."""
        recorded = [(group.begun_ns, group) for group in groups if group.begun_ns is not None]
        ends = [*(begun for begun, _ in recorded[1:]), None]
        return [
            group
            for (begun, group), end in zip(recorded, ends, strict=False)
            if (self.end_ns is None or begun < self.end_ns)
            and (self.begin_ns is None or end is None or end > self.begin_ns)
        ]
