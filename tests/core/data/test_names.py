"""Numeric order."""

from __future__ import annotations

from streamlod.core.data.names import in_numeric_order, listed


def test_numbers_sort_as_numbers() -> None:
    assert in_numeric_order(["cam_10", "cam_2", "cam_1"]) == ["cam_1", "cam_2", "cam_10"]
    assert in_numeric_order(["cam11", "cam02", "cam00"]) == ["cam00", "cam02", "cam11"]
    assert in_numeric_order(["b", "2", "a1b2", "a1b10", "a", "a²"]) == ["2", "a", "a1b2", "a1b10", "a²", "b"]


def test_long_lists_are_cut() -> None:
    assert listed(["a", "b", "c"], at_most=2) == "a, b and 1 more"
    assert listed([]) == ""
