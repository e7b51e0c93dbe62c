"""What is still to be shown in a board walk."""

from __future__ import annotations

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.walk_coverage import WalkCoverage

UNSEEN = np.full((24, 2), np.nan)


def board(x: float, y: float) -> Float64:
    """Corners of a small board about a point of the picture."""
    return np.stack(np.meshgrid([x - 0.05, x, x + 0.05], [y - 0.05, y, y + 0.05]), axis=-1).reshape(-1, 2)


def shown(coverage: WalkCoverage, *corners: Float64, times: int = 10) -> WalkCoverage:
    for _ in range(times):
        coverage = coverage.after(corners)
    return coverage


def test_who_has_not_seen_the_board_and_who_lacks_which_quarter_is_named() -> None:
    coverage = WalkCoverage.none(["a", "b"])
    assert not coverage.begun
    for place in [(0.2, 0.2), (0.8, 0.2), (0.8, 0.8)]:
        coverage = shown(coverage, board(*place), UNSEEN)
    assert coverage.begun
    needs = "; ".join(coverage.needs())
    assert "a needs it in the lower left" in needs
    assert "upper" not in needs
    assert "b has not seen it" in needs
    assert coverage.next_needs() == ["lower left", "not seen yet"]


def test_a_camera_that_has_seen_little_needs_it_everywhere() -> None:
    assert list(shown(WalkCoverage.none(["a"]), board(0.5, 0.5), times=1).needs()) == ["a needs it everywhere"]


def test_a_board_across_the_middle_counts_for_all_quarters_but_few_corners_for_none() -> None:
    middle = shown(WalkCoverage.none(["a"]), board(0.5, 0.5))
    assert list(middle.needs()) == []
    assert middle.next_needs() == [""]
    few = shown(WalkCoverage.none(["a"]), board(0.5, 0.5)[:4])
    assert not few.begun


def test_cameras_that_never_see_it_at_one_time_are_named() -> None:
    """Chains count: a sees it with b, and b with c; d sees it alone."""
    middle, coverage = board(0.5, 0.5), WalkCoverage.none(["a", "b", "c", "d"])
    for corners in [
        (middle, middle, UNSEEN, UNSEEN),
        (UNSEEN, middle, middle, UNSEEN),
        (UNSEEN, UNSEEN, UNSEEN, middle),
    ]:
        coverage = shown(coverage, *corners)
    assert list(coverage.needs()) == ["d and another camera need it at one time"]
    assert coverage.next_needs() == ["", "", "", "with another camera"]
    assert list(shown(coverage, UNSEEN, UNSEEN, middle, middle).needs()) == []
