"""Numbers of segments in a playlist ascend, whatever leaves."""

from __future__ import annotations

from streamlod.server.api.hls.numbers import SegmentNumbers
from streamlod.server.protocol.packets import Position


def places(*pairs: tuple[int, int]) -> list[Position]:
    return [Position(epoch, version) for epoch, version in pairs]


def test_numbers_ascend_while_groups_leave_at_the_front() -> None:
    numbers = SegmentNumbers()
    numbers.update(places((1, 0), (1, 10), (2, 0)), 5000, 2.0)
    assert (numbers.first, numbers.runs_before, numbers.longest) == (5000, 0, 2.0)
    numbers.update(places((1, 10), (2, 0), (2, 10)), 7000, 1.0)
    assert (numbers.first, numbers.runs_before, numbers.longest) == (5001, 0, 2.0)
    numbers.update(places((2, 0), (2, 10)), 9000, 3.5)
    assert (numbers.first, numbers.runs_before, numbers.longest) == (5002, 1, 3.5)


def test_what_follows_a_deletion_in_the_middle_or_of_all_is_numbered_anew() -> None:
    numbers = SegmentNumbers()
    numbers.update(places((1, 0), (1, 10), (1, 20)), 5000, 1.0)
    numbers.update(places((1, 0), (1, 20)), 5000, 1.0)
    assert (numbers.first, numbers.runs_before) == (5003, 1)
    numbers.update(places((4, 0)), 5000, 1.0)
    assert (numbers.first, numbers.runs_before) == (5005, 2)
