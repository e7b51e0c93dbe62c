"""Work of OpenCV and NumPy on the pictures of several cameras, in parallel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numba

from streamlod.core.arrays import Float32

Result = TypeVar("Result")


def map_pairs(function: Callable[[Float32, Float32], Result], pairs: Sequence[tuple[Float32, Float32]]) -> list[Result]:
    """The results of `function` for each pair of pictures [H,W,3], in order, on as many threads as kernels use.

    OpenCV and most of NumPy let other threads run meanwhile. `function` must not use tensors: torch has threads of its
    own for them.
    """
    threads = min(len(pairs), numba.get_num_threads())
    if threads < 2:
        return [function(*pair) for pair in pairs]
    with ThreadPoolExecutor(threads, "pictures") as pool:
        return list(pool.map(function, *zip(*pairs, strict=True)))
