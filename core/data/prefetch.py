"""Prepare the next items on a thread while the caller works on the current one."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Generator, Iterator
from typing import TypeVar

T = TypeVar("T")


def prefetch(items: Iterator[T], depth: int = 1) -> Generator[T, None, None]:
    """`items` in order, with up to `depth` of them prepared ahead on a background thread.

    An error of `items` is raised here, in its place. Closing or dropping the result stops the thread and closes
    `items`, on the thread that ran it.

    Raises:
        ValueError: `depth` below 1.
    """
    if depth < 1:
        raise ValueError(f"depth must be at least 1, not {depth}")
    return _prefetched(items, depth)


def _prefetched(items: Iterator[T], depth: int) -> Generator[T, None, None]:
    ready: deque[T] = deque()
    failure: list[BaseException] = []
    room, available = threading.Semaphore(depth), threading.Semaphore(0)
    stopping = threading.Event()

    def produce() -> None:
        try:
            while True:
                room.acquire()
                if stopping.is_set():
                    return
                try:
                    ready.append(next(items))
                except StopIteration:
                    return
                available.release()
        except BaseException as error:
            failure.append(error)
        finally:
            try:
                close = getattr(items, "close", None)
                if close is not None:
                    close()
            except BaseException as error:
                failure.append(error)
            available.release()  # wakes the caller, who finds nothing ready

    thread = threading.Thread(target=produce, name="prefetch", daemon=True)
    thread.start()
    try:
        while True:
            available.acquire()
            if not ready:
                break
            item = ready.popleft()
            room.release()
            yield item
            del item
    finally:
        stopping.set()
        room.release()
        thread.join()
    if failure:
        raise failure[0]
