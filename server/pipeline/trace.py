"""When each stage of each frame ran, as Chrome and Perfetto show it."""

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
        lane: what runs one after the other: read, train, encode or write.
        name: of the stage.
        begin, end: seconds of `time.perf_counter`.
    """

    lane: str
    name: str
    begin: float
    end: float


def timed(items: Iterator[T], lane: str) -> Generator[tuple[T, Span], None, None]:
    """Each item with the time it took to come."""
    while True:
        begin = time.perf_counter()
        try:
            item = next(items)
        except StopIteration:
            return
        yield item, Span(lane, lane, begin, time.perf_counter())


def timing(lane: str, work: Callable[[], T]) -> tuple[T, Span]:
    """What `work` returns, with the time it took."""
    begin = time.perf_counter()
    result = work()
    return result, Span(lane, lane, begin, time.perf_counter())


def chrome_trace(frames: Iterable[tuple[int, tuple[Span, ...]]]) -> dict[str, Any]:
    """Frames' numbers and spans in the trace event format, one row a lane."""
    events: list[dict[str, Any]] = []
    lanes: dict[str, int] = {}
    start: float | None = None
    for number, spans in frames:
        start = min((span.begin for span in spans), default=None) if start is None else start
        for span in spans:
            row = lanes.setdefault(span.lane, len(lanes) + 1)
            at, length = 1e6 * (span.begin - (start or 0)), 1e6 * (span.end - span.begin)
            event = {"name": span.name, "cat": span.lane, "ph": "X", "pid": 1, "tid": row, "ts": at, "dur": length}
            events.append({**event, "args": {"frame": number}})
    named = [
        {"name": "thread_name", "ph": "M", "pid": 1, "tid": row, "args": {"name": lane}} for lane, row in lanes.items()
    ]
    return {"traceEvents": [*named, *events], "displayTimeUnit": "ms"}
