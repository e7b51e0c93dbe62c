"""A clock by which a worker's silence is measured: it stands still while the watching program does."""

from __future__ import annotations

import time

_MOST_TURNS = 8  # a turn that comes this many times later than due was not slow: the program did not run


class RunningTime:
    """Seconds in which this program ran.

    A paused container, a suspended shell job or a frozen machine stops a worker and whoever watches it alike; on
    waking, the worker is not to blame for the time between. Every turn that comes far too late tells of such a pause.

    Args:
        turn_seconds: between two calls of `turn` while the program runs.
    """

    def __init__(self, turn_seconds: float) -> None:
        self._turn_seconds, self._away, self._last = turn_seconds, 0.0, time.monotonic()

    def now(self) -> float:
        """Seconds, from an arbitrary beginning; may be called from any thread."""
        return time.monotonic() - self._away

    def begin(self) -> None:
        """Turns begin again, after a time without any."""
        self._last = time.monotonic()

    def turn(self) -> None:
        """The program runs; to be called every `turn_seconds`."""
        before, self._last = self._last, time.monotonic()
        late = self._last - before - self._turn_seconds
        if late > _MOST_TURNS * self._turn_seconds:
            self._away += late
