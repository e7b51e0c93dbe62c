"""Work of OpenCV and NumPy on the pictures of several cameras, in parallel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar, TypeVarTuple

import numba

Result = TypeVar("Result")
Arguments = TypeVarTuple("Arguments")


def map_pictures(function: Callable[[*Arguments], Result], rows: Sequence[tuple[*Arguments]]) -> list[Result]:
    """The results of `function` for each row of arguments, in order, on as many threads as kernels use.

    OpenCV and most of NumPy let other threads run meanwhile. `function` must not use tensors: torch has threads of its
    own for them.
    """
    threads = min(len(rows), numba.get_num_threads())
    if threads < 2:
        return [function(*row) for row in rows]
    with ThreadPoolExecutor(threads, "pictures") as pool:
        return list(pool.map(lambda row: function(*row), rows))
