"""Work of OpenCV and NumPy on one camera's pictures, for several cameras at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numba

from core.arrays import Float32

Result = TypeVar("Result")


def side_by_side(
    function: Callable[[Float32, Float32], Result], pairs: Sequence[tuple[Float32, Float32]]
) -> list[Result]:
    """`function` of each of two pictures in `pairs`, in that order.

    OpenCV and NumPy let other threads run meanwhile, so with as many threads as the kernels have this takes as long as
    its slowest share; `function` must not touch a tensor, whose operations have threads of their own.
    """
    threads = min(len(pairs), numba.get_num_threads())
    if threads < 2:
        return [function(*pair) for pair in pairs]
    with ThreadPoolExecutor(threads, "pictures") as pool:
        return list(pool.map(function, *zip(*pairs, strict=True)))
