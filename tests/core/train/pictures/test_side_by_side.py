"""Pictures of several cameras at a time: every result in its place, however many threads, and no fault lost."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numba
import numpy as np
import pytest

from core.arrays import Float32
from core.train.pictures.side_by_side import side_by_side


@pytest.fixture(params=[1, 2])
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    before = numba.get_num_threads()
    count = min(request.param, numba.config.NUMBA_NUM_THREADS)
    numba.set_num_threads(count)
    yield count
    numba.set_num_threads(before)


def pairs(count: int) -> list[tuple[Float32, Float32]]:
    return [(np.full((2, 2), i, np.float32), np.full((2, 2), 10 * i, np.float32)) for i in range(count)]


def test_results_are_in_the_order_of_the_pairs(threads: int) -> None:
    assert side_by_side(lambda one, other: float((one + other)[0, 0]), pairs(7)) == [11.0 * i for i in range(7)]
    assert side_by_side(lambda one, other: 0, []) == []


def test_as_many_at_a_time_as_there_are_threads(threads: int) -> None:
    meeting = threading.Barrier(threads, timeout=10)
    side_by_side(lambda one, other: meeting.wait(), pairs(2 * threads))  # hangs, and so fails, where fewer run


def test_a_fault_of_one_is_raised(threads: int) -> None:
    def refuse(one: Float32, other: Float32) -> None:
        if one[0, 0] == 3:
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        side_by_side(refuse, pairs(5))
