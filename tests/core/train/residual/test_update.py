"""Which changes are sent where not all may be, and how far integers reach."""

from __future__ import annotations

import numpy as np

from streamlod.core.train.residual.update import IntegerUpdate, strongest_changes


def quanta(sizes: list[int]) -> IntegerUpdate:
    latent = np.zeros((len(sizes), 24), np.int32)
    latent[:, 3] = sizes
    wanted = np.concatenate([latent, np.zeros((len(sizes), 3))], axis=1).astype(np.float32) + 0.25
    return IntegerUpdate(latent, np.zeros((len(sizes), 3), np.int32), np.zeros(len(sizes), np.bool_), wanted=wanted)


def test_few_changes_are_all_kept() -> None:
    few = quanta([1, 0, -2])
    assert strongest_changes(few, 2) is few


def test_the_largest_changes_are_kept() -> None:
    kept = strongest_changes(quanta([9, 1, -20, 0, 5]), 3)
    assert kept.latent[:, 3].tolist() == [9, 0, -20, 0, 5]
    assert not kept.complete
    assert not strongest_changes(quanta([9, 1]), 0).latent.any()


def test_what_is_not_sent_is_left_to_do_but_never_much() -> None:
    kept = strongest_changes(quanta([9, 1]), 1)
    assert kept.remainder[0, 3] == 0.25  # rounding
    assert kept.remainder[1, 3] == 1.25  # rounding and a change that was held back
    held = strongest_changes(quanta([9, -8]), 1)
    assert held.remainder[1, 3] == -2.0


def test_a_change_that_points_as_the_one_before_goes_on() -> None:
    moved = quanta([10, -1000, 6, 4])
    before = moved.sent * np.array([[1], [0.001], [-1], [0]], np.float32)
    assert moved.continued(0.5, before, done=True)[:, 3].tolist() == [5.0, -64.0, 0.0, 0.0]
    assert not moved.continued(0.0, before, done=True).any()
    assert moved.continued(0.5, before, done=True).dtype == np.float32


def test_what_was_cut_short_is_added_to_what_goes_on() -> None:
    moved = quanta([10, 6])
    before = moved.sent * np.array([[1], [-1]], np.float32)
    assert moved.continued(0.5, before, done=False)[:, 3].tolist() == [5.25, 0.25]
