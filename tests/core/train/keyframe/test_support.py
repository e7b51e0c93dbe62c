"""Places by the cameras that see them, and what follows for dropout and prices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.initialise.views import inside, project
from streamlod.core.train.config import KeyframeConfig
from streamlod.core.train.keyframe.support import in_view, support
from streamlod.core.train.keyframe.tables import tables_of
from streamlod.core.train.optimise.schedule import dropout_keep
from streamlod.core.train.pictures.views import Views
from tests.core.train.fields import random_field

UP = np.array([0.0, -1.0, 0.0])


def camera(x: float, ahead: float) -> Camera:
    eye = np.array([x, 0.0, -4.0])
    return pinhole(f"{x}", (40, 40), (24, 16), (48, 32), look_at(eye, np.array([ahead, 0.0, 0.0]), UP))


def angle(point: np.ndarray, one: Camera, other: Camera) -> float:
    """Degrees between two cameras as seen from `point` [3]."""
    first, second = one.centre - point, other.centre - point
    cosine = first @ second / (np.linalg.norm(first) * np.linalg.norm(second))
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


CAMERAS = camera(-1, -1), camera(0, 0), camera(2, 4)


def supported(points: Tensor, cameras: Sequence[Camera]) -> Tensor:
    return support(in_view(points, cameras), points, cameras)


def test_support_is_the_share_of_the_other_cameras_that_see_the_place_from_the_same_side() -> None:
    points = np.random.default_rng(0).uniform(-6, 6, (500, 3)).astype(np.float32)
    found = supported(torch.from_numpy(points), CAMERAS).numpy()
    for point, value in zip(points.astype(np.float64), found, strict=True):
        seeing = [c for c in CAMERAS if inside(c, *project(c, point[None]))[0]]
        agreeing = [sum(other is not one and angle(point, one, other) <= 60 for other in seeing) for one in seeing]
        assert value == pytest.approx(np.mean(agreeing) / 2 if seeing else 0.0, abs=1e-6)
    assert {0.0, 0.5, 1.0} <= set(np.round(found, 6).tolist())
    assert (supported(torch.from_numpy(points), CAMERAS[:1]) == 0).all()


def test_cameras_that_face_each_other_do_not_agree() -> None:
    opposite = (
        pinhole("front", (40, 40), (24, 16), (48, 32), look_at(np.array([0.0, 0.0, -4.0]), np.zeros(3), UP)),
        pinhole("back", (40, 40), (24, 16), (48, 32), look_at(np.array([0.0, 0.0, 4.0]), np.zeros(3), UP)),
    )
    assert supported(torch.zeros(1, 3), opposite).tolist() == [0.0]
    assert supported(torch.zeros(1, 3), (opposite[0], camera(0, 0))).tolist() == [1.0]


def test_backgrounds_and_prices_of_a_first_frame_follow() -> None:
    """A camera's background is random as often as others agree, in the mean of the places in its picture."""
    field = random_field(200)
    field = replace(field, position=4 * field.position)
    views = Views(CAMERAS, torch.zeros(3, 32, 48, 3), [0, 1, 2])
    tables = tables_of(field, views, torch.zeros(200, field.slots), by_support=True)
    expected, visible = supported(field.position, CAMERAS), in_view(field.position, CAMERAS)
    assert len(set(expected.tolist())) > 1
    for number, share in tables.backgrounds.items():
        assert share == pytest.approx(float(expected[visible[number]].mean()))
    level, shares, price, _ = tables.of_gaussians(torch.tensor([3, 7]))
    assert shares.tolist() == expected[[3, 7]].repeat_interleave(field.slots).tolist()
    torch.testing.assert_close(price, 0.25 + 0.75 * shares)
    assert level.tolist() == field.level[[3, 7]].repeat_interleave(field.slots).tolist()
    alone = replace(views, cameras=(camera(50, 99),), usable=[0])  # it has none of them in its picture
    assert tables_of(field, alone, torch.zeros(200, field.slots), by_support=False).backgrounds == {0: 0.0}


def test_what_one_camera_sees_is_never_left_out() -> None:
    config = KeyframeConfig(dropout_base=0.4, dropout_slope=0.0)
    shares = torch.tensor([0.0, 0.5, 1.0]).repeat_interleave(20_000)
    kept = dropout_keep(torch.zeros(60_000, dtype=torch.long), 1, config, 1.0, torch.Generator().manual_seed(0), shares)
    for part, rate in zip(kept.reshape(3, -1), (0.0, 0.2, 0.4), strict=True):
        assert abs(float((part == 0).float().mean()) - rate) < 0.01
        assert abs(float(part.mean()) - 1) < 0.02
