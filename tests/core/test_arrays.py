"""The nearest time, against the table of all distances."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from streamlod.core.arrays import nearest_of

NUMBERS = st.integers(-50, 50)


@given(st.lists(NUMBERS, min_size=1, max_size=9), st.lists(NUMBERS, max_size=9))
def test_it_is_the_first_of_the_least_distances(among: list[int], times: list[int]) -> None:
    places = np.array(sorted(set(among)), np.float64)
    wanted = np.abs(places - np.array(times, np.float64)[:, None]).argmin(axis=1)
    assert nearest_of(places, np.array(times, np.float64)).tolist() == wanted.tolist()
