"""The peak of memory follows what is allocated, and can be forgotten."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from streamlod.client.evaluation.measure.memory import forget_peak, peak_bytes

SIZE = 256 * 2**20


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux forgets a peak")
def test_the_peak_remembers_what_was_freed_until_it_is_forgotten() -> None:
    forget_peak()
    before = peak_bytes()
    array = np.ones(SIZE, np.uint8)
    assert peak_bytes() >= before + 0.9 * SIZE
    del array
    assert peak_bytes() >= before + 0.9 * SIZE
    forget_peak()
    assert peak_bytes() < before + 0.5 * SIZE
