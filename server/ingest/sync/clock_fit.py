"""A robust line fit of a camera's clock against ours, from pairs of times, some of which are wrong."""

from __future__ import annotations

from collections import deque
from statistics import median

_PAIRS = 60
_DRIFT_SPAN_NS = 20_000_000_000  # over less, jitter would look like drift
_MAX_DRIFT = 500e-6  # crystals are within 100 ppm; more is damage
_STEP_NS = 250_000_000  # off the line, from which a pair is set aside
_AGREE_NS = 50_000_000  # between offsets that agree


class Line:
    """y = x + offset + drift (x - x0), fitted to the latest pairs (x, y), all in nanoseconds.

    The drift is the median of the slopes between pairs far apart (Theil 1950, Sen 1968). The offset is the median of
    the residuals, or their minimum with `lower`, for a y that can be late but never early.

    A pair far off the line is set aside. When `patience` of them in a row agree on another offset, one of the clocks
    was set, and the line begins anew with them.
    """

    def __init__(self, *, lower: bool = False, patience: int = 2) -> None:
        self._lower, self._patience = lower, patience
        self._pairs: deque[tuple[int, int]] = deque(maxlen=_PAIRS)
        self._aside: deque[tuple[int, int]] = deque(maxlen=patience)
        self._origin = self._offset = 0
        self._drift = 0.0
        self._spread_ns = 0.0
        self.steps = 0

    def __bool__(self) -> bool:
        return bool(self._pairs)

    @property
    def drift_ppm(self) -> float:
        """How much faster y runs than x, in parts per million; 0 until twenty seconds were seen."""
        return self._drift * 1e6

    @property
    def error_ns(self) -> int:
        """Spread of the pairs about the line: 1.48 times the median absolute deviation."""
        return round(self._spread_ns)

    def at(self, x: int) -> int:
        """y on the line."""
        return x + self._offset + round(self._drift * (x - self._origin))

    def add(self, x: int, y: int) -> None:
        """Add a pair; one with the same x as the last replaces it."""
        if self._pairs:
            off = y - self.at(x)
            if self._lower and off < -_STEP_NS:  # nothing can arrive early, so all earlier pairs were delayed
                self._pairs.clear()
            elif abs(off) > _STEP_NS:
                self._set_aside(x, y)
                return
        self._aside.clear()
        if self._pairs and self._pairs[-1][0] == x:
            self._pairs.pop()
        self._pairs.append((x, y))
        self._fit()

    def _set_aside(self, x: int, y: int) -> None:
        self._aside.append((x, y))
        offsets = [late - early for early, late in self._aside]
        if len(offsets) == self._patience and max(offsets) - min(offsets) < _AGREE_NS:
            self._pairs.clear()
            self._pairs.extend(self._aside)
            self._aside.clear()
            self.steps += 1
            self._fit()

    def _fit(self) -> None:
        self._origin, y = self._pairs[-1]
        base = y - self._origin  # times since 1970 have more digits than a float
        differences = [(x - self._origin, y - x - base) for x, y in self._pairs]
        slopes = [
            (later - earlier) / (end - begin)
            for n, (begin, earlier) in enumerate(differences)
            for end, later in differences[n + 1 :]
            if end - begin >= _DRIFT_SPAN_NS
        ]
        self._drift = min(max(median(slopes), -_MAX_DRIFT), _MAX_DRIFT) if slopes else 0.0
        left = [difference - self._drift * x for x, difference in differences]
        offset = min(left) if self._lower else median(left)
        self._offset = base + round(offset)
        self._spread_ns = 1.4826 * median(abs(value - offset) for value in left)
