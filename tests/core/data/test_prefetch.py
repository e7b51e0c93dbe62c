"""Preparing ahead on a thread."""

from __future__ import annotations

import gc
import threading
from collections.abc import Iterator

import pytest

from streamlod.core.data import prefetch


class Counted:
    """Counts to `end`, remembering how far it was asked, whether it was closed, and on which threads it ran."""

    def __init__(self, end: int, fail_at: int | None = None) -> None:
        self.end, self.fail_at = end, fail_at
        self.made = 0
        self.closed = False
        self.threads: set[int] = set()
        self.reached = threading.Condition()

    def __iter__(self) -> Iterator[int]:
        return self

    def __next__(self) -> int:
        self.threads.add(threading.get_ident())
        if self.made == self.fail_at:
            raise OSError("the disk is gone")
        if self.made == self.end:
            raise StopIteration
        with self.reached:
            self.made += 1
            self.reached.notify_all()
        return self.made - 1

    def close(self) -> None:
        self.closed = True

    def wait_for(self, made: int) -> None:
        with self.reached:
            assert self.reached.wait_for(lambda: self.made >= made, timeout=60)


def _threads() -> int:
    return sum(thread.name == "prefetch" for thread in threading.enumerate())


def test_everything_arrives_in_order_from_another_thread() -> None:
    items = Counted(100)
    assert list(prefetch(items, 3)) == list(range(100))
    assert items.closed
    assert threading.get_ident() not in items.threads
    assert _threads() == 0


@pytest.mark.parametrize("depth", [1, 4])
def test_the_next_items_are_made_while_the_caller_works_and_no_more(depth: int) -> None:
    items = Counted(100)
    stream = prefetch(items, depth)
    assert next(stream) == 0
    items.wait_for(1 + depth)  # would wait for ever if nothing were made ahead
    for _ in range(3):
        next(stream)
    items.wait_for(4 + depth)
    assert items.made <= 4 + depth
    stream.close()  # type: ignore[attr-defined]


def test_an_error_arrives_after_what_came_before_it() -> None:
    stream = prefetch(Counted(100, fail_at=2))
    assert [next(stream), next(stream)] == [0, 1]
    with pytest.raises(OSError, match="the disk is gone"):
        next(stream)
    assert _threads() == 0


def test_closing_and_dropping_stop_the_thread_and_close_the_items() -> None:
    items = Counted(100)
    stream = prefetch(items, 2)
    next(stream)
    stream.close()  # type: ignore[attr-defined]
    assert items.closed
    dropped = Counted(100)
    stream = prefetch(dropped, 2)
    next(stream)
    del stream
    gc.collect()
    assert dropped.closed
    assert _threads() == 0


def test_nothing_runs_before_the_first_item_is_asked_for() -> None:
    items = Counted(3)
    prefetch(items)
    assert items.made == 0
    assert list(prefetch(iter([]))) == []
    with pytest.raises(ValueError, match="depth"):
        prefetch(items, 0)
