"""How fast one viewer is sent to, and with how many levels. Pure arithmetic on given times, no I/O."""

from __future__ import annotations

from dataclasses import dataclass

_CALM_SECONDS = 5.0  # without congestion, before one more level is tried
_MAX_CALM_SECONDS = 80.0


class Throttle:
    """A byte rate that is not exceeded on average.

    Args:
        bytes_per_second: the rate, or None for no bound.

    Attributes:
        free_at: time before which the rate would be exceeded, in seconds.
    """

    def __init__(self, bytes_per_second: float | None) -> None:
        self._rate = bytes_per_second
        self.free_at = 0.0

    @property
    def bounded(self) -> bool:
        """Whether there is a rate at all."""
        return self._rate is not None

    def spend(self, size_bytes: int, now: float) -> None:
        """Count `size_bytes` that were sent."""
        if self._rate is not None:
            self.free_at = max(self.free_at, now) + size_bytes / self._rate


class Allowance:
    """A limit on messages a second, on average; two seconds' worth may come at once.

    Args:
        per_second: messages.
        now: time at which it begins, in seconds.
    """

    def __init__(self, per_second: float, now: float) -> None:
        self.per_second = per_second
        self._left, self._at = 2 * per_second, now

    def take(self, now: float) -> bool:
        """Count one message; returns whether it is within the limit."""
        self._left = min(2 * self.per_second, self._left + self.per_second * (now - self._at)) - 1
        self._at = now
        return self._left >= 0


@dataclass(slots=True)
class LevelControl:
    """How many levels a viewer gets: one less whenever it falls behind, one more after a time without congestion.

    If a raised level causes congestion, the time before it is tried again is doubled, so that quality recovers without
    flickering.

    Attributes:
        wanted: levels that the viewer asked for.
        levels: levels it gets.
        calm_seconds: how long it must keep up before a level is tried again.
        quiet_since, raised_at: times of the last congestion or raise, and of a raise that has not failed yet.
        asked: whether the viewer has just asked for more.
    """

    wanted: int
    levels: int
    calm_seconds: float = _CALM_SECONDS
    quiet_since: float = 0.0
    raised_at: float | None = None
    asked: bool = False

    def congested(self, now: float) -> None:
        """The viewer fell behind."""
        if self.raised_at is not None and now - self.raised_at < 2 * self.calm_seconds:
            self.calm_seconds = min(2 * self.calm_seconds, _MAX_CALM_SECONDS)
        self.raised_at, self.quiet_since, self.asked = None, now, False
        self.levels = max(1, self.levels - 1)

    def may_raise(self, now: float) -> bool:
        """Whether another level should be tried."""
        return self.levels < self.wanted and now - self.quiet_since >= self.calm_seconds

    def raise_level(self, now: float) -> None:
        """Send another level; all wanted ones, if the viewer has just asked for them."""
        self.levels = self.wanted if self.asked else min(self.levels + 1, self.wanted)
        self.asked = False
        self.raised_at = self.quiet_since = now

    def want(self, levels: int, now: float) -> None:
        """The viewer asks for `levels`; more are given at once."""
        self.wanted = levels
        self.calm_seconds, self.quiet_since = _CALM_SECONDS, now - _CALM_SECONDS
        self.asked = levels > self.levels
        self.levels = min(self.levels, levels)
