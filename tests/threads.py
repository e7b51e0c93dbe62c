"""How many threads the kernels of this thread use: one in each of pytest's processes, unless a test says otherwise."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import numba
import torch

MAX_THREADS: int = numba.config.NUMBA_NUM_THREADS


def one_for_each_worker() -> None:
    """Where pytest runs in several processes, these share the cores among them."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        numba.set_num_threads(1)
        torch.set_num_threads(1)


@contextmanager
def kernel_threads(count: int) -> Iterator[None]:
    """Run the kernels that are called in the context on so many threads, at most `MAX_THREADS`."""
    before = numba.get_num_threads()
    numba.set_num_threads(count)
    try:
        yield
    finally:
        numba.set_num_threads(before)
