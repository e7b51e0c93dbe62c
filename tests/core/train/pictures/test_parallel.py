"""Work on several cameras' pictures in parallel: results in order, as many threads as kernels use, no fault lost."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from streamlod.core.arrays import Float32
from streamlod.core.train.pictures.parallel import map_pictures
from tests.threads import MAX_THREADS, kernel_threads


@pytest.fixture(params=[1, MAX_THREADS])
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    with kernel_threads(request.param):
        yield request.param


def pairs(count: int) -> list[tuple[Float32, Float32]]:
    return [(np.full((2, 2), i, np.float32), np.full((2, 2), 10 * i, np.float32)) for i in range(count)]


def test_results_are_in_the_order_of_the_pairs(threads: int) -> None:
    assert map_pictures(lambda one, other: float((one + other)[0, 0]), pairs(7)) == [11.0 * i for i in range(7)]
    assert map_pictures(lambda one, other: 0, []) == []


def test_as_many_at_a_time_as_there_are_threads(threads: int) -> None:
    meeting = threading.Barrier(threads, timeout=60)
    map_pictures(lambda one, other: meeting.wait(), pairs(2 * threads))  # hangs, and so fails, where fewer run


def test_a_fault_of_one_is_raised(threads: int) -> None:
    def refuse(one: Float32, other: Float32) -> None:
        if one[0, 0] == 3:
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        map_pictures(refuse, pairs(5))
