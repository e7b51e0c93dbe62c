"""The Pareto front: points that no other point beats."""

from __future__ import annotations

from collections.abc import Sequence


def pareto_front(points: Sequence[tuple[float, float]]) -> tuple[int, ...]:
    """Rows of the (cost, quality) points that no other point dominates, by rising cost.

    A point dominates another if it costs no more and is no worse, and is better in one of the two. Of equal points the
    first is kept.
    """
    order = sorted(range(len(points)), key=lambda row: (points[row][0], -points[row][1], row))
    front, best = [], float("-inf")
    for row in order:
        if points[row][1] > best:
            front.append(row)
            best = points[row][1]
    return tuple(front)
