"""How fast a camera films while it films: times without pictures are told elsewhere, and do not count."""

from __future__ import annotations

from collections import deque

_SECOND_NS = 1_000_000_000
_SILENT_NS = _SECOND_NS  # between two pictures: more is no slow camera, but one that was away
_WINDOW_NS = 5 * _SECOND_NS  # of filming, over which a rate is taken
_JUDGED_NS = _WINDOW_NS // 2  # of filming, from which on there is a rate
_MAX_GAPS = 1024  # kept; a camera that sends more in five seconds is not slow
_SLOWEST = 0.8  # of the rate that is wanted, below which a camera is slow


class Pace:
    """The pace of one camera's pictures over its last five seconds of filming."""

    def __init__(self) -> None:
        self._newest_ns: int | None = None
        self._gaps = deque[int]()  # from picture to picture, nanoseconds
        self._filming_ns = 0  # their sum

    def note(self, now_ns: int) -> None:
        """A picture came now."""
        gap = None if self._newest_ns is None else now_ns - self._newest_ns
        self._newest_ns = now_ns
        if gap is None or gap > _SILENT_NS:
            return
        self._gaps.append(gap)
        self._filming_ns += gap
        while len(self._gaps) > _MAX_GAPS or self._filming_ns - self._gaps[0] >= _WINDOW_NS:
            self._filming_ns -= self._gaps.popleft()

    @property
    def rate(self) -> float | None:
        """Pictures a second; None where it has not filmed for long enough."""
        return len(self._gaps) * _SECOND_NS / self._filming_ns if self._filming_ns >= _JUDGED_NS else None


def is_slow(rate: float | None, fps: float) -> bool:
    """Whether pictures come more slowly than `fps` wants them."""
    return rate is not None and rate < _SLOWEST * fps
