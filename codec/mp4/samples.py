"""Samples of the track of scenes: the packets of one instant, each with its size before it. FORMAT.md section 19."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from streamlod.codec.container.layout import SIZE, Entry
from streamlod.codec.packet.packet import PacketKind

TIMESCALE = 1_000_000  # of times in the track, a second
_NS = 1000
_LAST = 33_333  # of the last sample of all, where nothing says how long it is to be seen


@dataclass(frozen=True, slots=True)
class Sample:
    """A sample.

    Attributes:
        time: at which it is shown, microseconds on the clock of the packets' times.
        duration: microseconds until the next one.
        size_bytes: its length.
        is_sync: whether decoding can begin with it.
        first, count: its packets among those of the whole.
    """

    time: int
    duration: int
    size_bytes: int
    is_sync: bool
    first: int
    count: int


def microseconds(time_ns: int) -> int:
    """A packet's time in units of the track."""
    return time_ns // _NS


def samples_of(entries: Sequence[Entry], end: int | None = None) -> list[Sample]:
    """The samples that carry these packets, which lie one after the other.

    A packet that is not later than the current sample belongs to it, unless it begins another keyframe. That begins a
    new sample, at least a microsecond after the one before, as times have to grow.

    Args:
        end: when the last sample ends, in microseconds; by default it lasts as long as the one before it.
    """
    begins = list(_begins(entries))
    found: list[Sample] = []
    for (first, is_sync), behind in zip(begins, [*(at for at, _ in begins[1:]), len(entries)], strict=False):
        time = microseconds(entries[first].time_ns)
        if found:
            time = max(time, found[-1].time + 1)
        size = sum(SIZE.size + entry.size_bytes for entry in entries[first:behind])
        found.append(Sample(time, 0, size, is_sync, first, behind - first))
    return _with_durations(found, end)


def _begins(entries: Sequence[Entry]) -> Iterator[tuple[int, bool]]:
    """Numbers of the packets that begin a sample, and whether they begin a keyframe."""
    time, keyframe = -1, -1
    for number, entry in enumerate(entries):
        is_new_key = entry.kind is PacketKind.KEY and entry.keyframe != keyframe
        if is_new_key or microseconds(entry.time_ns) > time:
            time = microseconds(entry.time_ns)
            yield number, is_new_key
        keyframe = entry.keyframe


def _with_durations(samples: list[Sample], end: int | None) -> list[Sample]:
    if not samples:
        return []
    if end is None or end <= samples[-1].time:
        end = samples[-1].time + (samples[-1].time - samples[-2].time if len(samples) > 1 else _LAST)
    ends = [*(sample.time for sample in samples[1:]), end]
    return [replace(s, duration=min(until - s.time, 2**32 - 1)) for s, until in zip(samples, ends, strict=True)]
