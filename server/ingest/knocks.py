"""Watches whether cameras were knocked since a rig is read, by what they see, in a fiftieth of the time.

Cameras are looked at in turn, and one whose picture has changed as a whole at once: each frame that is trained on a
knocked camera leaves false colours behind. Two looks in a row must say the same of a camera, that it has moved or that
it is back in its place. Where more than half of the cameras seem to have moved, it is the scene that did. A look that
breaks ends the watch, not the stream.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor

import cv2
import numpy as np

from streamlod.core.arrays import Bool, UInt8
from streamlod.core.calibration.checks.matches import Features
from streamlod.core.calibration.checks.shift import OFF, Shift, landmarks, shift
from streamlod.server.ingest.watch import Watch

_SHARE = 0.02  # of the time that looking may take
_SAVED_SECONDS = 10.0  # in which nothing was looked at count as time for it; frames that train long are few
_AHEAD_SECONDS = 10.0  # of which a picture that has changed may use the time ahead
_SAMPLES = 24  # rows and columns of pixels by which a picture is compared with the one that was looked at before
_CHANGED, _WHOLE = 16, 0.3  # grey levels of a pixel, and the share of such pixels in a picture that changed as a whole
_RENEWED_BELOW = 0.25  # share of its landmarks; a camera in its place that shows fewer gets new ones


class Knocks:
    """The cameras of a rig.

    Args:
        count: of cameras.
        clock: seconds.

    Attributes:
        shifts: of each camera, pixels at a width of 1000 that its picture has moved; None where nothing tells.
    """

    def __init__(self, count: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.shifts: list[float | None] = [None] * count
        self._landmarks: list[Features | None] = [None] * count
        self._last: list[Shift | None] = [None] * count
        self._seen: list[UInt8 | None] = [None] * count
        self._clock, self._next, self._due = clock, 0, -np.inf
        self._watch = Watch("knocked cameras are no longer watched for", self._forget)

    @property
    def knocked(self) -> Bool:
        """[C] which cameras were."""
        moved = np.array([found is not None and found >= OFF for found in self.shifts], np.bool_)
        return moved if 2 * moved.sum() <= len(moved) else np.zeros_like(moved)

    def look(self, images: Sequence[UInt8] | UInt8, present: Bool, pool: Executor) -> None:
        """Look at some of the newest pictures [H,W,3] on a thread of `pool`, as far as there is time."""
        self._watch.begin(lambda: self._look(images, present), pool)

    def _forget(self) -> None:
        self.shifts = [None] * len(self.shifts)

    def _look(self, images: Sequence[UInt8] | UInt8, present: Bool) -> None:
        samples = [_samples(image) for image in images]
        urgent = [number for number, here in enumerate(present) if here and self._is_urgent(number, samples[number])]
        in_turn = [(self._next + step) % len(present) for step in range(len(present))]
        for number in [*urgent, *(number for number in in_turn if number not in urgent)]:
            begin = self._clock()
            if begin < self._due - _AHEAD_SECONDS * (number in urgent):
                continue
            if present[number]:
                self._seen[number] = samples[number]
                self._compare(number, landmarks(images[number]))
            if number not in urgent:
                self._next = (number + 1) % len(present)
            self._due = max(self._due, begin - _SAVED_SECONDS) + (self._clock() - begin) / _SHARE

    def _is_urgent(self, number: int, samples: UInt8) -> bool:
        """Whether a camera's picture has changed as a whole since it was looked at, or waits for a second look."""
        before, last, shift = self._seen[number], self._last[number], self.shifts[number]
        if last is not None and (last.pixels >= OFF) != (shift is not None and shift >= OFF):
            return True
        return before is not None and bool((cv2.absdiff(before, samples) > _CHANGED).mean() > _WHOLE)

    def _compare(self, number: int, now: Features) -> None:
        first = self._landmarks[number]
        if first is None:
            self._landmarks[number] = now
            return
        last, found = self._last[number], shift(first, now)
        self._last[number] = found
        if last is None or found is None or abs(last.pixels - found.pixels) >= OFF:
            return  # somebody walks by: what was known holds
        self.shifts[number] = found.pixels
        if found.pixels < OFF and found.matches < _RENEWED_BELOW * len(first.points):
            self._landmarks[number] = now


def _samples(picture: UInt8) -> UInt8:
    """Some pixels from all over a picture [H,W,3]."""
    rows, columns = (np.linspace(0, side - 1, min(side, _SAMPLES)).astype(int) for side in picture.shape[:2])
    return np.asarray(picture[rows[:, None], columns])
