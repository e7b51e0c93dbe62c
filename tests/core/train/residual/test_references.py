"""Where a change goes on to be trained."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from core.train.residual.references import stagnant

TARGET = torch.full((2, 20, 30, 3), 0.5)


def shown(error: float) -> Tensor:
    """A picture that is right on its left half and off by `error` in green on its right."""
    picture = TARGET.clone()
    picture[:, :, 15:, 1] += error
    return picture


@pytest.mark.parametrize(("before", "now", "ends"), [(0.3, 0.2, False), (0.3, 0.28, True), (0.1, 0.2, True)])
def test_training_ends_where_it_takes_less_than_a_tenth_off(before: float, now: float, ends: bool) -> None:
    found = stagnant(TARGET, shown(before), shown(now))
    assert (found[:, :, 15:] == ends).all()
    assert not found[:, :, :13].any()  # nothing is wrong, nothing to end; two pixels of the window are


def test_one_pixel_does_not_decide() -> None:
    """Noise of a pixel is averaged over its neighbourhood."""
    now = shown(0.2)
    now[:, 10, 22, 1] = 0.5 + 0.3
    assert not stagnant(TARGET, shown(0.3), now).any()


def test_what_is_not_known_goes_on() -> None:
    before = shown(0.3)
    before[0] = math.nan
    found = stagnant(TARGET, before, shown(0.3))
    assert not found[0].any()
    assert found[1, :, 15:].all()
    assert not stagnant(TARGET, None, shown(0.3)).any()
