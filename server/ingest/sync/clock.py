"""Capture times: one clock for each camera, which uses the best evidence there is.

In order of trust: the sender's own wall clock (RTP with NTP sender reports, or the time a capture node states), a time
code in the picture, a hardware frame number of a genlocked rig, and the arrival here less what the network delays.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction

from streamlod.core.camera.grid import period_of
from streamlod.server.ingest.sync.clock_fit import Line

_SECOND_NS = 1_000_000_000
_DAY_NS = 86_400 * _SECOND_NS
PLAUSIBLE_NS = 5 * _SECOND_NS  # a sender's clock further off than this was never set
_PATIENCE_NS = 6 * _SECOND_NS  # senders report every five seconds
_WARM_UP_NS = _SECOND_NS  # the first pictures of a connection come from buffers
_UNKNOWN_DELAY_NS = 20_000_000  # arrival shows jitter, not the delay that all pictures share


class ClockSource(StrEnum):
    """Evidence of a capture time."""

    NTP = "ntp"
    STATED = "stated"
    TIMECODE = "timecode"
    FRAME_NUMBER = "frame_number"
    FILE = "file"
    ARRIVAL = "arrival"


@dataclass(frozen=True, slots=True)
class CaptureTime:
    """When a picture was taken, nanoseconds since 1970; from which evidence; how far it may be off."""

    capture_ns: int
    source: ClockSource
    error_ns: int


@dataclass(frozen=True, slots=True)
class Sighting:
    """Evidence of one picture's time.

    Attributes:
        arrival_ns: when it came, on our timeline.
        media_ns: presentation time in its stream, on a scale of its own.
        stated_ns: the capture time that a capture node gave.
        timecode_ns: time of day of an embedded time code.
        frame_number: hardware count shared by all cameras of a genlocked rig.
    """

    arrival_ns: int
    media_ns: int | None = None
    stated_ns: int | None = None
    timecode_ns: int | None = None
    frame_number: int | None = None


class CaptureClock:
    """One camera's clock.

    Args:
        fps: of the rig; what a frame number counts.
        epoch_ns: when frame number 0 was taken; the same for all cameras of a rig.
        expects_ntp: hold pictures back until the sender's first report, for six seconds at most, because a camera that
            changes clocks while others don't would be paired wrongly. Without, one second, until delays are known.
    """

    def __init__(self, fps: float, epoch_ns: int = 0, *, expects_ntp: bool = False) -> None:
        self._period_ns = period_of(fps)
        self._epoch_ns, self._expects_ntp = epoch_ns, expects_ntp
        self._sender, self._envelope = Line(), Line(lower=True, patience=5)
        self._least: tuple[int, int] | None = None  # the least delayed pair of the current second
        self._since_ns: int | None = None
        self._source = ClockSource.ARRIVAL

    @property
    def drift_ppm(self) -> float:
        """How much faster the wall clock runs than the stream's, in parts per million."""
        return (self._sender if self._source is ClockSource.NTP else self._envelope).drift_ppm

    def observe_report(self, media_ns: int, ntp_ns: int) -> None:
        """A sender said that `media_ns` was taken at `ntp_ns`."""
        self._sender.add(media_ns, ntp_ns)

    def capture(self, seen: Sighting) -> CaptureTime | None:
        """When a picture was taken, or None while better evidence is expected soon.

        Pictures come in the order of their arrival.
        """
        if self._since_ns is None:
            self._since_ns = seen.arrival_ns
        arrival = self._by_arrival(seen)
        found = self._by_sender(seen) or self._by_number(seen)
        if found is None:
            patience = _PATIENCE_NS if self._expects_ntp and not self._sender else _WARM_UP_NS
            if seen.arrival_ns - self._since_ns < patience:
                return None
            found = arrival
        self._source = found.source
        return found

    def _by_sender(self, seen: Sighting) -> CaptureTime | None:
        if self._sender and seen.media_ns is not None:
            time = CaptureTime(self._sender.at(seen.media_ns), ClockSource.NTP, self._sender.error_ns)
            if _is_plausible(time.capture_ns, seen):
                return time
        if seen.stated_ns is not None and _is_plausible(seen.stated_ns, seen):
            return CaptureTime(seen.stated_ns, ClockSource.STATED, 0)
        if seen.timecode_ns is not None:
            capture = date_timecode(seen.timecode_ns, seen.arrival_ns)
            if _is_plausible(capture, seen):
                return CaptureTime(capture, ClockSource.TIMECODE, round(self._period_ns / 2))
        return None

    def _by_number(self, seen: Sighting) -> CaptureTime | None:
        if seen.frame_number is None:
            return None
        capture = self._epoch_ns + round(seen.frame_number * self._period_ns)
        return CaptureTime(capture, ClockSource.FRAME_NUMBER, 0)

    def _by_arrival(self, seen: Sighting) -> CaptureTime:
        media = seen.media_ns if seen.media_ns is not None else seen.stated_ns
        if media is None:
            return CaptureTime(seen.arrival_ns, ClockSource.ARRIVAL, _UNKNOWN_DELAY_NS + round(self._period_ns))
        if not self._envelope:
            self._envelope.add(media, seen.arrival_ns)
        self._collect(media, seen.arrival_ns)
        error = _UNKNOWN_DELAY_NS + self._envelope.error_ns
        return CaptureTime(min(self._envelope.at(media), seen.arrival_ns), ClockSource.ARRIVAL, error)

    def _collect(self, media: int, arrival: int) -> None:
        """Add the least delayed picture of each second to the envelope, or at once one that lies below it."""
        if self._least is None or not 0 <= media - self._least[0] < _SECOND_NS:
            if self._least is not None:
                self._envelope.add(*self._least)
            self._least = (media, arrival)
        elif arrival - media < self._least[1] - self._least[0]:
            self._least = (self._least[0], arrival - media + self._least[0])
            if arrival < self._envelope.at(media):
                self._envelope.add(*self._least)


def _is_plausible(capture_ns: int, seen: Sighting) -> bool:
    return abs(seen.arrival_ns - capture_ns) < PLAUSIBLE_NS


def date_timecode(time_of_day_ns: int, arrival_ns: int) -> int:
    """The instant with this UTC time of day that is nearest to the arrival, nanoseconds since 1970."""
    day = round((arrival_ns - time_of_day_ns) / _DAY_NS)
    return day * _DAY_NS + time_of_day_ns


def read_timecode(packed: int, fps: Fraction) -> int | None:
    """Time of day in nanoseconds of a time code as FFmpeg packs it (SMPTE ST 12-1 binary groups), or None if damaged.

    Args:
        packed: 32 bits: drop flag, then frames, seconds, minutes and hours as decimal digits.
        fps: frames a second; above 30, a time code counts pairs of frames and a flag tells the second one.
    """
    frames = (packed >> 28 & 3) * 10 + (packed >> 24 & 15)
    seconds = (packed >> 20 & 7) * 10 + (packed >> 16 & 15)
    minutes = (packed >> 12 & 7) * 10 + (packed >> 8 & 15)
    hours = (packed >> 4 & 3) * 10 + (packed & 15)
    if fps > 30:
        frames = frames * 2 + (packed >> (7 if fps == 50 else 23) & 1)
    nominal = round(fps)
    if frames >= nominal or seconds > 59 or minutes > 59 or hours > 23:
        return None
    count = ((hours * 60 + minutes) * 60 + seconds) * nominal + frames
    if packed >> 30 & 1:  # two numbers a minute are left out, except every tenth minute
        total = hours * 60 + minutes
        count -= round(nominal / 15) * (total - total // 10)
    return round(count * _SECOND_NS / fps)
