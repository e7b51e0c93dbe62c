"""How many threads the kernels use that a test calls."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numba

MAX_THREADS: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]  # set as it is loaded


@contextmanager
def kernel_threads(count: int) -> Iterator[None]:
    """Run the kernels that are called in the context on so many threads, at most `MAX_THREADS`."""
    before = numba.get_num_threads()
    numba.set_num_threads(count)
    try:
        yield
    finally:
        numba.set_num_threads(before)
