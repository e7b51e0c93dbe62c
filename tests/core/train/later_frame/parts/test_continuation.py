"""Where the next frame begins: the change goes on where it did before, and what was not sent is made good."""

from __future__ import annotations

import numpy as np

from streamlod.core.train.later_frame.parts.continuation import continued, remainder
from streamlod.core.train.later_frame.update import strongest_changes
from tests.core.train.later_frame.test_update import quanta


def test_what_is_not_sent_is_left_to_do_but_never_much() -> None:
    kept = strongest_changes(quanta([9, 1]), 1)
    assert remainder(kept)[0, 3] == 0.25  # rounding
    assert remainder(kept)[1, 3] == 1.25  # rounding and a change that was held back
    held = strongest_changes(quanta([9, -8]), 1)
    assert remainder(held)[1, 3] == -2.0


def test_a_change_that_points_as_the_one_before_goes_on() -> None:
    moved = quanta([10, -1000, 6, 4])
    before = moved.sent * np.array([[1], [0.001], [-1], [0]], np.float32)
    assert continued(moved, 0.5, before, done=True)[:, 3].tolist() == [5.0, -64.0, 0.0, 0.0]
    assert not continued(moved, 0.0, before, done=True).any()
    assert continued(moved, 0.5, before, done=True).dtype == np.float32


def test_what_was_cut_short_is_added_to_what_goes_on() -> None:
    moved = quanta([10, 6])
    before = moved.sent * np.array([[1], [-1]], np.float32)
    assert continued(moved, 0.5, before, done=False)[:, 3].tolist() == [5.25, 0.25]
