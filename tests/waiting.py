"""Waiting for what happens elsewhere: in another process, another thread, a browser."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

Found = TypeVar("Found")
PATIENCE = 180.0  # seconds; to start a worker took 54 where twelve programs shared two cores


def wait(done: Callable[[], Found], seconds: float = PATIENCE) -> Found:
    """What `done` returns once that is true; it fails after a time that only a fault takes, and shows what it was."""
    limit = time.monotonic() + seconds
    while not (found := done()):
        assert time.monotonic() < limit, found
        time.sleep(0.02)
    return found
