"""A bounded queue from a producing thread to a generator: one step of a pipeline."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Generator
from typing import Generic, TypeVar

T = TypeVar("T")


class Unwanted(Exception):
    """The consumer has gone; raised in the producer, which lets it propagate."""


class Outlet(Generic[T]):
    """The producer's end of the queue, which holds at most `depth` items."""

    def __init__(self, depth: int) -> None:
        self._depth, self._items = depth, deque[T]()
        self._change = threading.Condition()
        self._closed = self._done = False

    def put(self, item: T) -> None:
        """Put `item` into the queue, waiting for room.

        Raises:
            Unwanted: the consumer has gone.
        """
        with self._change:
            self._change.wait_for(lambda: self._closed or len(self._items) < self._depth)
            if self._closed:
                raise Unwanted
            self._items.append(item)
            self._change.notify_all()

    def check(self) -> None:
        """Raise Unwanted if the consumer has gone, to end long work early."""
        if self._closed:
            raise Unwanted

    def _take(self) -> T | None:
        with self._change:
            self._change.wait_for(lambda: self._items or self._done)
            if not self._items:
                return None
            self._change.notify_all()
            return self._items.popleft()

    def _finish(self, *, closed: bool) -> None:
        with self._change:
            self._closed, self._done = self._closed or closed, True
            self._change.notify_all()


def made_by(make: Callable[[Outlet[T]], None], name: str, depth: int = 1) -> Generator[T, None, None]:
    """The items that `make` puts into its outlet, while it runs on a thread called `name`, at most `depth` items ahead.

    An error of `make` is raised here, after the items before it. Closing or dropping the generator makes the outlet
    raise Unwanted, and waits for `make` to end.
    """
    outlet, failure = Outlet[T](depth), list[BaseException]()

    def run() -> None:
        try:
            make(outlet)
        except Unwanted:
            pass
        except BaseException as error:
            failure.append(error)
        finally:
            outlet._finish(closed=False)

    thread = threading.Thread(target=run, name=name, daemon=True)
    thread.start()
    try:
        while (item := outlet._take()) is not None:
            yield item
    finally:
        outlet._finish(closed=True)
        thread.join()
    if failure:
        raise failure[0]
