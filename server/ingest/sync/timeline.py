"""One clock for arrivals: starts at the wall clock's time and continues monotonically, unaffected by its steps."""

from __future__ import annotations

import time


class Timeline:
    """Nanoseconds since 1970 as of the start, plus what the monotonic clock has counted since."""

    def __init__(self) -> None:
        self._offset_ns = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """The present; never goes back."""
        return time.monotonic_ns() + self._offset_ns
