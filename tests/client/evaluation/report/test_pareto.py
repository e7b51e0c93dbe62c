"""The Pareto front: nothing on it is beaten, everything else is."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from streamlod.client.evaluation.report.pareto import pareto_front

values = st.integers(-5, 5).map(float)
clouds = st.lists(st.tuples(values, values), max_size=30)


def dominates(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return one[0] <= other[0] and one[1] >= other[1] and one != other


@given(clouds)
def test_nothing_dominates_the_front_and_the_front_covers_the_rest(points: list[tuple[float, float]]) -> None:
    front = [points[row] for row in pareto_front(points)]
    assert not any(dominates(point, kept) for kept in front for point in points)
    assert all(point in front or any(dominates(kept, point) for kept in front) for point in points)


@given(clouds)
def test_the_front_rises_in_cost_and_quality(points: list[tuple[float, float]]) -> None:
    front = [points[row] for row in pareto_front(points)]
    assert all(a[0] < b[0] and a[1] < b[1] for a, b in pairwise(front))


def test_of_equal_points_the_first_is_kept() -> None:
    assert pareto_front([(1, 1), (1, 1), (2, 1), (2, 3), (1, 0)]) == (0, 3)
