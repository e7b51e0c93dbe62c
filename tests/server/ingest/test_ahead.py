"""Values made shortly before they are wanted."""

from __future__ import annotations

import itertools
import threading
import time
from contextlib import closing

import pytest

from streamlod.server.ingest.ahead import just_in_time
from tests.waiting import wait


def test_the_next_one_is_made_while_the_last_one_is_used_but_not_at_its_beginning() -> None:
    begun: list[float] = []
    asked: list[float] = []

    def make() -> int:
        begun.append(time.monotonic())
        time.sleep(0.02)
        return len(begun) - 1

    with closing(just_in_time(make, lambda _: None)) as values:
        got = []
        for _ in range(8):
            asked.append(time.monotonic())
            got.append(next(values))
            time.sleep(0.2)
    assert got == sorted(set(got))
    ahead = [k for k in range(3, 8) if begun[got[k]] < asked[k]]
    assert ahead  # all of them on a quiet machine
    assert any(begun[got[k]] - asked[k - 1] > 0.05 for k in ahead)


def test_one_that_is_not_asked_for_is_made_anew_and_the_old_one_discarded() -> None:
    numbers, discarded = itertools.count(), list[int]()
    with closing(just_in_time(lambda: next(numbers), discarded.append)) as values:
        assert next(values) == 0
        time.sleep(0.02)
        assert next(values) == 1
        wait(lambda: len(discarded) >= 3)
        value = next(values)
    assert discarded == sorted(discarded)
    assert value not in discarded
    assert value > discarded[2]


def test_ends_with_the_maker_and_raises_its_errors() -> None:
    values = iter([3, 4])
    assert list(just_in_time(lambda: next(values, None), lambda _: None)) == [3, 4]

    def broken() -> int:
        raise OSError("no camera")

    with pytest.raises(OSError, match="no camera"):
        next(just_in_time(broken, lambda _: None))


def test_closing_ends_the_thread() -> None:
    with closing(just_in_time(lambda: 1, lambda _: None)) as values:
        assert next(values) == 1
    end = time.monotonic() + 60
    while "just in time" in [thread.name for thread in threading.enumerate()]:
        assert time.monotonic() < end
        time.sleep(0.01)
