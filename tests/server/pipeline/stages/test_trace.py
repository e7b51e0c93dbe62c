"""Chrome's trace event format."""

from __future__ import annotations

import time
from collections.abc import Iterator

from streamlod.server.pipeline.stages.trace import Span, chrome_trace, timed, timing


def test_events_have_a_row_a_lane_and_microseconds_from_the_first() -> None:
    frames = [
        (0, (Span("read", "read", 5.0, 5.5), Span("train", "partition", 5.5, 6.0))),
        (1, (Span("read", "read", 5.5, 6.0),)),
    ]
    events = chrome_trace(frames)["traceEvents"]
    names = {event["tid"]: event["args"]["name"] for event in events if event["ph"] == "M"}
    assert names == {1: "read", 2: "train"}
    shown = [(e["tid"], e["name"], e["ts"], e["dur"], e["args"]["frame"]) for e in events if e["ph"] == "X"]
    assert shown == [(1, "read", 0, 5e5, 0), (2, "partition", 5e5, 5e5, 0), (1, "read", 5e5, 5e5, 1)]
    assert chrome_trace([])["traceEvents"] == []


def test_spans_cover_the_work() -> None:
    def slow() -> Iterator[int]:
        for number in range(2):
            time.sleep(0.01)
            yield number

    begin = time.perf_counter()
    items = list(timed(slow(), "read"))
    result, span = timing("encode", lambda: 7)
    assert [item for item, _ in items] == [0, 1]
    assert result == 7
    edges = [begin, *(edge for _, s in items for edge in (s.begin, s.end)), span.begin, span.end]
    assert edges == sorted(edges)
    assert all(s.end - s.begin >= 0.01 for _, s in items)
