"""Order, errors and endings of a pipeline's step."""

from __future__ import annotations

import threading
import time

import pytest

from streamlod.server.pipeline.stages.bounded_queue import Outlet, Unwanted, made_by


def test_items_come_in_order_and_no_more_than_the_depth_wait() -> None:
    made: list[int] = []

    def make(outlet: Outlet[int]) -> None:
        for number in range(6):
            made.append(number)
            outlet.put(number)

    items = made_by(make, "maker", depth=2)
    assert next(items) == 0
    end = time.monotonic() + 60
    while len(made) < 4:  # two wait, and the maker stands with the next one
        assert time.monotonic() < end
        time.sleep(0.005)
    time.sleep(0.05)
    assert made == [0, 1, 2, 3]
    assert list(items) == [1, 2, 3, 4, 5]
    assert not [thread for thread in threading.enumerate() if thread.name == "maker"]


def test_an_error_comes_after_what_was_made_before_it() -> None:
    def make(outlet: Outlet[str]) -> None:
        outlet.put("first")
        raise RuntimeError("broken")

    items = made_by(make, "maker")
    assert next(items) == "first"
    with pytest.raises(RuntimeError, match="broken"):
        next(items)


def test_a_maker_whose_work_nobody_wants_is_told() -> None:
    told = []

    def make(outlet: Outlet[int]) -> None:
        try:
            for number in range(100):
                outlet.put(number)
        except Unwanted:
            told.append("put")
            with pytest.raises(Unwanted):
                outlet.check()
            raise

    items = made_by(make, "maker")
    assert next(items) == 0
    items.close()
    assert told == ["put"]
    assert not [thread for thread in threading.enumerate() if thread.name == "maker"]
