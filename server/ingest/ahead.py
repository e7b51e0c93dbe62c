"""Prepares a value just before it is asked for, from the newest input."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator
from typing import Generic, TypeVar

T = TypeVar("T")
_HEAD_START = 2.0  # times the seconds that the last one took to make
_PATIENCE = 0.25  # share of the last interval, after which a value not asked for is too old


def just_in_time(make: Callable[[], T | None], discard: Callable[[T], None]) -> Generator[T, None, None]:
    """Values that `make` returns, until it is None; each is made on a thread, to be ready when it is asked for.

    Requests come at similar intervals. So the next value is begun one interval after the last request, less twice the
    time that making takes: late enough to be new, early enough not to be waited for. An earlier request begins it at
    once. If the request is late, the value is discarded and made again.

    Args:
        make: called on one thread only; may wait. An error is raised here.
        discard: called with each value that is not given out.
    """
    maker = _Maker(make, discard)
    maker.thread.start()
    try:
        while (value := maker.ask()) is not None:
            yield value
    finally:
        maker.stop()
    if maker.failure is not None:
        raise maker.failure


class _Maker(Generic[T]):
    """The thread that makes values, and what it shares with the thread that asks for them."""

    def __init__(self, make: Callable[[], T | None], discard: Callable[[T], None]) -> None:
        self._make, self._discard = make, discard
        self._change = threading.Condition()
        self._ready: T | None = None
        self._ready_at = self._took = 0.0
        self._asked_at = self._interval = float("inf")
        self._wanted = self._over = False
        self.failure: BaseException | None = None
        self.thread = threading.Thread(target=self._run, name="just in time", daemon=True)

    def ask(self) -> T | None:
        """The next value, or None at the end."""
        with self._change:
            now = time.monotonic()
            self._interval, self._asked_at = now - self._asked_at, now
            self._wanted = self._ready is None
            self._change.notify_all()
            self._change.wait_for(lambda: self._ready is not None or self._over)
            value, self._ready = self._ready, None
            return value

    def stop(self) -> None:
        """Stop making values; the caller has to make sure that `make` does not wait for ever."""
        with self._change:
            self._over = True
            self._change.notify_all()

    def _run(self) -> None:
        try:
            while self._wait_until_due():
                begin = time.monotonic()
                value = self._make()
                if value is None:
                    return
                self._hand_over(value, time.monotonic() - begin)
        except BaseException as error:
            self.failure = error
        finally:
            self.stop()

    def _wait_until_due(self) -> bool:
        """Wait until the next value is due; False after `stop`."""
        with self._change:
            while not self._over and not self._wanted:
                seconds = self._due_at() - time.monotonic()
                if seconds <= 0:
                    break
                self._change.wait(min(seconds, threading.TIMEOUT_MAX))
            return not self._over

    def _due_at(self) -> float:
        if not 0 <= self._interval < float("inf"):  # asked for once at most
            return float("inf")
        if self._ready is not None:
            return self._ready_at + _PATIENCE * self._interval
        return self._asked_at + self._interval - _HEAD_START * self._took

    def _hand_over(self, value: T, took: float) -> None:
        with self._change:
            old, self._ready, self._wanted = self._ready, value, False
            self._ready_at, self._took = time.monotonic(), took
            self._change.notify_all()
        if old is not None:
            self._discard(old)
