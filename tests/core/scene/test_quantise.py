"""Rounding rules."""

from __future__ import annotations

import numpy as np

from streamlod.core.scene.quantise import trailing_zeros


def test_trailing_zeros_are_those_of_the_whole_row() -> None:
    matrix = np.array([[4, 8, -12], [1, 0, 0], [0, 0, 0], [-256, 512, 0]])
    assert trailing_zeros(matrix, 7).tolist() == [2, 0, 7, 7]
