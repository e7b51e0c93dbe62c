"""Which changes are sent where not all may be, and how far integers reach."""

from __future__ import annotations

import numpy as np

from streamlod.core.train.later_frame.update import IntegerUpdate, strongest_changes


def quanta(sizes: list[int]) -> IntegerUpdate:
    latent = np.zeros((len(sizes), 24), np.int32)
    latent[:, 3] = sizes
    return IntegerUpdate(latent, np.zeros((len(sizes), 3), np.int32), np.zeros(len(sizes), np.bool_))


def test_few_changes_are_all_kept() -> None:
    few = quanta([1, 0, -2])
    assert strongest_changes(few, 2) is few


def test_the_largest_changes_are_kept() -> None:
    kept = strongest_changes(quanta([9, 1, -20, 0, 5]), 3)
    assert kept.latent[:, 3].tolist() == [9, 0, -20, 0, 5]
    assert not kept.complete
    assert not strongest_changes(quanta([9, 1]), 0).latent.any()
