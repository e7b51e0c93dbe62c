"""Where a change goes on to be trained."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from streamlod.core.camera import look_at, pinhole
from streamlod.core.train.later_frame.references import as_filmed, renewed_references, stagnant
from streamlod.core.train.later_frame.state import KnownPictures, State, fresh_state
from streamlod.core.train.pictures.views import Views
from tests.client.web.scenes import make_scene

TARGET = torch.full((2, 20, 30, 3), 0.5)


def shown(error: float) -> Tensor:
    """A picture that is right on its left half and off by `error` in green on its right."""
    picture = TARGET.clone()
    picture[:, :, 15:, 1] += error
    return picture


@pytest.mark.parametrize(("before", "now", "ends"), [(0.3, 0.2, False), (0.3, 0.28, True), (0.1, 0.2, True)])
def test_training_ends_where_it_takes_less_than_a_tenth_off(before: float, now: float, ends: bool) -> None:
    found = stagnant(TARGET, shown(before), shown(now), 0.1)
    assert (found[:, :, 15:] == ends).all()
    assert not found[:, :, :13].any()  # nothing is wrong, nothing to end; two pixels of the window are


def test_one_pixel_does_not_decide() -> None:
    """Noise of a pixel is averaged over its neighbourhood."""
    now = shown(0.2)
    now[:, 10, 22, 1] = 0.5 + 0.3
    assert not stagnant(TARGET, shown(0.3), now, 0.1).any()


def test_what_is_not_known_goes_on() -> None:
    before = shown(0.3)
    before[0] = math.nan
    found = stagnant(TARGET, before, shown(0.3), 0.1)
    assert not found[0].any()
    assert found[1, :, 15:].all()


CAMERA = pinhole(
    "cam", (30, 30), (15, 10), (30, 20), look_at(np.array([0.0, 0, -3]), np.zeros(3), np.array([0.0, -1, 0]))
)
VIEWS = Views((CAMERA, CAMERA), TARGET, [0, 1])
MASK = torch.zeros(2, 20, 30, dtype=torch.bool)
MASK[:, :, 10:] = True


NOTHING = torch.full_like(TARGET, torch.nan)


def state(before: Tensor) -> State:
    """One that shows `before`, was compared with 0.1 and filmed 0.2."""
    known = KnownPictures(torch.full_like(TARGET, 0.1), torch.full_like(TARGET, 0.2), before)
    return fresh_state(make_scene(20), "cpu", known)


def renewed(before: Tensor, now: Tensor, *, done: bool = True) -> tuple[Tensor, Tensor]:
    after = renewed_references(state(before), state(before), VIEWS, MASK, now, done=done)
    references = after.known.references
    assert (references[~MASK] == 0.1).all()
    return references[0, 10, 25], references[0, 10, 11]


def test_the_reference_is_what_is_shown_while_training_gets_on_and_then_what_was_filmed() -> None:
    torch.testing.assert_close(renewed(shown(0.3), shown(0.2))[0], torch.tensor([0.5, 0.7, 0.5]))
    torch.testing.assert_close(renewed(shown(0.3), shown(0.29))[0], torch.tensor([0.5, 0.5, 0.5]))


def test_brighter_than_white_is_no_progress() -> None:
    """Pictures end at 1, and so does what counts of those that are shown."""
    assert renewed(shown(0.7), shown(0.7))[0][1] == 0.5


def test_a_change_that_no_anchor_shows_ends() -> None:
    assert renewed(NOTHING, NOTHING)[0][1] == 0.5


def test_where_training_was_cut_short_a_little_is_enough_to_go_on() -> None:
    for now, green in ((0.2, 0.7), (0.29, 0.79), (0.3, 0.5)):
        right, _ = renewed(shown(0.3), shown(now), done=False)
        torch.testing.assert_close(right, torch.tensor([0.5, green, 0.5]))
    assert renewed(shown(0.3), NOTHING, done=False)[0][1] == 0.1  # nobody had time for this camera


def test_a_camera_that_joins_is_compared_with_what_it_films() -> None:
    after = as_filmed(state(NOTHING), VIEWS, [1]).known
    for pictures in (after.references, after.filmed):
        assert (pictures[1] == 0.5).all()
        assert (pictures[0] < 0.3).all()
