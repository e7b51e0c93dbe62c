"""How much work a call does, counted so that it is the same on every machine: as time is not."""

from __future__ import annotations

import sys
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any


class TooMuchWork(AssertionError):
    """A call did more work than it may."""


class Lines:
    """Lines of Python that were run."""

    def __init__(self, most: int) -> None:
        self.count, self._most = 0, most

    def trace(self, frame: FrameType, event: str, _: Any) -> Any:
        """Count a line; for `sys.settrace`."""
        if event == "line":
            self.count += 1
            if self.count > self._most:
                sys.settrace(None)
                raise TooMuchWork(f"more than {self._most} lines were run, {frame.f_code.co_filename} among them")
        return self.trace


@contextmanager
def lines(most: int = sys.maxsize) -> Iterator[Lines]:
    """Count the lines that this thread runs in the context; more than `most` end it with `TooMuchWork`.

    What one call of NumPy does is one line, so this bounds time together with a limit of memory. Numba's kernels count
    with their lines in a process that compiles none (``NUMBA_DISABLE_JIT=1``).
    """
    found, before = Lines(most), sys.gettrace()
    sys.settrace(found.trace)
    try:
        yield found
    finally:
        sys.settrace(before)


class Memory:
    """Memory that objects of Python and arrays of NumPy took together at most."""

    peak_bytes = 0


@contextmanager
def memory() -> Iterator[Memory]:
    """Measure the memory that is taken in the context; its peak is known after it."""
    found = Memory()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        yield found
        found.peak_bytes = tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()


def bytes_read() -> int:
    """Bytes that this process has asked of files and sockets so far, also those that lay in memory (Linux)."""
    return int(Path("/proc/self/io").read_text().split()[1])
