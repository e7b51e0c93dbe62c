"""The sound of each camera of a rig, kept for a while to be compared: a clap tells how far their times are apart."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from fractions import Fraction
from statistics import median_low
from typing import Protocol

import av
import numpy as np

from streamlod.core.arrays import Float64, Int16
from streamlod.core.calibration.sound.alike import RATE, rises
from streamlod.core.data.video.sound import Placer
from streamlod.core.errors import InputError

_KEPT_S = 60  # of a camera
_APART_S = 5  # that cameras' times may be apart to be compared


class Ear(Protocol):
    """A taker of one source's sound, called from its reader's thread."""

    source: str

    def put(self, frame: av.AudioFrame, capture_ns: int) -> None:
        """Sound has come, whose first sample was recorded at `capture_ns`."""

    def gone(self, reason: str) -> None:
        """The source gives no sound for now."""


class Ears:
    """Several ears for one source.

    Args:
        ears: one at least.
    """

    def __init__(self, ears: Sequence[Ear]) -> None:
        self.source = ears[0].source
        self._ears = tuple(ears)

    def put(self, frame: av.AudioFrame, capture_ns: int) -> None:
        """See `Ear.put`."""
        for ear in self._ears:
            ear.put(frame, capture_ns)

    def gone(self, reason: str) -> None:
        """See `Ear.gone`."""
        for ear in self._ears:
            ear.gone(reason)


class CameraEar:
    """The first minute of what one camera hears.

    Args:
        source: name of the camera.
        offset_ns: nanoseconds that are added to the times of its sound, as to those of its pictures.
    """

    def __init__(self, source: str, offset_ns: int) -> None:
        self.source = source
        self._offset_ns = offset_ns
        self._lock = threading.Lock()
        self._placer = Placer(RATE, 1)
        self._blocks: list[tuple[int, Int16]] = []
        self._count = 0

    def put(self, frame: av.AudioFrame, capture_ns: int) -> None:
        """See `Ear.put`; sound that cannot be used is left out."""
        with self._lock:
            if self._count >= _KEPT_S * RATE:
                return
            try:
                found = list(self._placer.put(frame, Fraction(capture_ns + self._offset_ns, 1_000_000_000)))
            except (InputError, av.FFmpegError, ValueError):
                return
            self._blocks += found
            self._count += sum(len(block) for _, block in found)

    def gone(self, reason: str) -> None:
        """See `Ear.gone`."""

    @property
    def begin(self) -> int | None:
        """The number of the first sample, counted from 1970; None while there is no sound."""
        with self._lock:
            return self._blocks[0][0] if self._blocks else None

    def samples(self, begin: int, count: int) -> Int16:
        """[count,1] samples from number `begin` on, silent where none came."""
        found = np.zeros((count, 1), np.int16)
        with self._lock:
            for first, block in self._blocks:
                low, high = max(first, begin), min(first + len(block), begin + count)
                if low < high:
                    found[low - begin : high - begin] = block[low - first : high - first]
        return found


def loudness_rises(listeners: Mapping[str, CameraEar]) -> dict[str, Float64]:
    """How the loudness rises at each camera that hears, on the clock that pairs pictures."""
    begins = {name: begin for name, each in listeners.items() if (begin := each.begin) is not None}
    if not begins:
        return {}
    first = median_low(begins.values()) - _APART_S * RATE
    return {name: rises(listeners[name].samples(first, (_KEPT_S + 2 * _APART_S) * RATE)) for name in begins}
