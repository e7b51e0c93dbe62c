"""Rounding rules."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from streamlod.core.scene.quantise import dead_zone, trailing_zeros

finite = st.floats(-1e12, 1e12)


def test_known_values() -> None:
    values = np.array([0.0, 0.65, 0.67, -0.65, -0.67, 1.65, 1.67, -2.9])
    assert dead_zone(values, 0.34).tolist() == [0, 0, 1, 0, -1, 1, 2, -3]


@given(arrays(np.float64, 20, elements=finite), st.floats(0.01, 0.5))
def test_odd_bounded_and_towards_zero(values: np.ndarray, offset: float) -> None:
    rounded = dead_zone(values, offset)
    np.testing.assert_array_equal(dead_zone(-values, offset), -rounded)
    inside = np.abs(values) < 2.0**30
    assert (np.abs(rounded - values)[inside] <= 1 - offset + 1e-3).all()
    assert (np.abs(rounded) <= np.abs(values) + offset).all()


@pytest.mark.parametrize(("values", "offset"), [([1.0], 0.0), ([1.0], 0.6), ([np.nan], 0.3), ([np.inf], 0.3)])
def test_refusals(values: list[float], offset: float) -> None:
    with pytest.raises(ValueError, match=r"rounding offset|finite"):
        dead_zone(np.array(values), offset)


def test_trailing_zeros_are_those_of_the_whole_row() -> None:
    matrix = np.array([[4, 8, -12], [1, 0, 0], [0, 0, 0], [-256, 512, 0]])
    assert trailing_zeros(matrix, 7).tolist() == [2, 0, 7, 7]
