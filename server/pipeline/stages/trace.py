"""When each stage of each frame ran, in the trace format of Chrome and Perfetto."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Span:
    """A stage of a frame.

    Attributes:
        track: row of the trace, whose spans follow each other: read, train, encode or write.
        name: of the stage.
        begin, end: seconds of `time.perf_counter`.
    """

    track: str
    name: str
    begin: float
    end: float


def timed(items: Iterator[T], track: str) -> Generator[tuple[T, Span], None, None]:
    """Each item with the time it took to come."""
    while True:
        begin = time.perf_counter()
        try:
            item = next(items)
        except StopIteration:
            return
        yield item, Span(track, track, begin, time.perf_counter())


def timing(track: str, work: Callable[[], T]) -> tuple[T, Span]:
    """The result of `work`, with the time it took."""
    begin = time.perf_counter()
    result = work()
    return result, Span(track, track, begin, time.perf_counter())


def chrome_trace(frames: Iterable[tuple[int, tuple[Span, ...]]]) -> dict[str, Any]:
    """(frame, spans) pairs in the trace event format, one row a track."""
    events: list[dict[str, Any]] = []
    tracks: dict[str, int] = {}
    start: float | None = None
    for number, spans in frames:
        start = min((span.begin for span in spans), default=None) if start is None else start
        for span in spans:
            row = tracks.setdefault(span.track, len(tracks) + 1)
            at, length = 1e6 * (span.begin - (start or 0)), 1e6 * (span.end - span.begin)
            event = {"name": span.name, "cat": span.track, "ph": "X", "pid": 1, "tid": row, "ts": at, "dur": length}
            events.append({**event, "args": {"frame": number}})
    named = [
        {"name": "thread_name", "ph": "M", "pid": 1, "tid": row, "args": {"name": track}}
        for track, row in tracks.items()
    ]
    return {"traceEvents": [*named, *events], "displayTimeUnit": "ms"}
