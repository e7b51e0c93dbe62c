"""One clock for arrivals: the wall's at the start, then at monotonic pace, untouched by steps of the wall."""

from __future__ import annotations

import time


class Timeline:
    """Nanoseconds since 1970 as of the start, plus what the monotonic clock has counted since."""

    def __init__(self) -> None:
        self._offset_ns = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """The present; never goes back."""
        return time.monotonic_ns() + self._offset_ns
