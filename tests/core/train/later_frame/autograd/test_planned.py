"""Pictures of half the size ask for what has changed, and for nothing that is only drawn differently there."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from streamlod.core.camera import pinhole
from streamlod.core.render.tiles import TILE_HEIGHT, TILE_WIDTH
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.convert import scene_of
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.rendered import rendered
from streamlod.core.train.later_frame.autograd.planned import PlannedView, planned_view
from streamlod.core.train.later_frame.comparison import Comparison
from streamlod.core.train.later_frame.state import KnownPictures, State
from streamlod.core.train.pictures.views import Views
from tests.core.train.fields import random_field
from tests.core.train.later_frame.begun import bare_state

WIDTH, HEIGHT = 8 * TILE_WIDTH, 6 * TILE_HEIGHT
POSE = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]])
CAMERA = pinhole("cam00", (WIDTH, WIDTH), (WIDTH / 2, HEIGHT / 2), (WIDTH, HEIGHT), POSE)
CENTRE = torch.from_numpy(CAMERA.centre).float()


@pytest.fixture
def state() -> State:
    return bare_state(scene_of(random_field(200), PredictConfig(), (CAMERA,), 30.0, 0))


def comparison(targets: Tensor, shown: Tensor | None) -> Comparison:
    masks = torch.zeros(1, HEIGHT, WIDTH, dtype=torch.bool)
    masks[0, 11, 21] = True
    known = KnownPictures(targets, targets, torch.full_like(targets, torch.nan) if shown is None else shown)
    return Comparison(Views((CAMERA,), targets, [0]), masks, known)


def planned(state: State, targets: Tensor, shown: Tensor | None) -> tuple[PlannedView, Splats]:
    """The view at half the size of which every second anchor is trained; the Gaussians of these."""
    trained = torch.arange(len(state.field)) % 2 == 0
    moving, still = (state.field.decode(CENTRE, torch.nonzero(rows)[:, 0]).detached() for rows in (trained, ~trained))
    half = comparison(targets, shown).halved()
    return planned_view(half, 0, moving, still, torch.zeros(3), "cpu", 1.5), moving


def picture_of(state: State) -> Tensor:
    return rendered(state.field, state.alive, Views((CAMERA,), torch.zeros(1, HEIGHT, WIDTH, 3), [0]), "cpu")


def test_half_the_size_is_half_of_everything(state: State) -> None:
    shown = picture_of(state)
    half = comparison(shown, shown).halved()
    assert half.views.targets.shape == (1, HEIGHT // 2, WIDTH // 2, 3)
    assert (half.views.cameras[0].width, half.views.cameras[0].height) == (WIDTH // 2, HEIGHT // 2)
    assert half.masks.nonzero().tolist() == [[0, 5, 10]]
    torch.testing.assert_close(half.known.shown[0, 5, 10], shown[0, 10:12, 20:22].mean(dim=(0, 1)))


def test_errors_of_changed_pixels_count_more(state: State) -> None:
    weights = planned(state, picture_of(state), None)[0].weights
    assert weights is not None
    assert weights[5, 10].tolist() == [2.5, 2.5, 2.5]
    assert float(weights.sum()) == weights.numel() + 3 * 1.5


def test_what_has_not_changed_asks_for_nothing(state: State) -> None:
    shown = picture_of(state)
    half, moving = planned(state, shown, shown)
    drawn = half.cache.render(moving).image.clone()
    assert float((drawn - half.target).abs().max()) > 0.005  # they are drawn wider
    torch.testing.assert_close(half.allowing_for_size(moving).target, drawn)


def test_what_has_changed_asks_for_as_much_as_at_full_size(state: State) -> None:
    shown = picture_of(state)
    half, moving = planned(state, (shown + 0.25).clone(), shown)
    wanted = half.allowing_for_size(moving).target - half.cache.render(moving).image
    torch.testing.assert_close(wanted, torch.full_like(wanted, 0.25))


def test_where_nothing_is_known_to_be_shown_the_picture_itself_counts(state: State) -> None:
    target = picture_of(state)
    for shown in (None, torch.full_like(target, torch.nan)):
        half, moving = planned(state, target, shown)
        torch.testing.assert_close(half.allowing_for_size(moving).target, half.target)
