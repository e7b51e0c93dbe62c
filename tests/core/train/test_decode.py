"""The trainer's decoding against the decoder's reference arithmetic."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from core.anchors import Scene
from core.expand import expand
from core.train.config import PredictConfig
from core.train.convert import field_of, level_starts, scene_of
from tests.core.train.fields import random_field


@pytest.mark.parametrize("view_dependent", [False, True])
@pytest.mark.parametrize("slots", [1, 4, 10])
def test_decode_equals_expand(view_dependent: bool, slots: int) -> None:
    scene = _scene(view_dependent, slots)
    centre = np.array([0.3, -0.2, -4.0])
    with torch.no_grad():
        splats = field_of(scene).decode(torch.from_numpy(centre).float())
    drawn = splats.opacities > 0
    cloud = expand(scene, centre)
    assert 0 < len(cloud) < len(splats)
    for mine, reference in (
        (splats.means, cloud.means),
        (splats.quaternions, cloud.quaternions),
        (splats.scales, cloud.scales),
        (splats.opacities, cloud.opacities),
        (splats.colours, cloud.colours),
    ):
        np.testing.assert_allclose(mine[drawn].numpy(), reference, rtol=2e-5, atol=2e-6)


def test_rounding_a_rounded_field_changes_nothing() -> None:
    scene = _scene(False, 4)
    again = scene_of(field_of(scene), PredictConfig(), scene.header.cameras, 30.0, scene.version)
    for first, second in zip(scene.levels, again.levels, strict=True):
        for name in ("voxel", "feature", "offset", "scaling", "extra_level"):
            np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_level_starts_follow_the_levels() -> None:
    scene = _scene(False, 2)
    starts = level_starts(scene)
    assert np.diff(starts).tolist() == [len(level) for level in scene.levels]
    field = field_of(scene)
    for number in range(len(scene.levels)):
        assert (field.level[starts[number] : starts[number + 1]] == number).all()


def _scene(view_dependent: bool, slots: int) -> Scene:
    field = random_field(anchors=60, slots=slots, view_dependent=view_dependent)
    return scene_of(field, PredictConfig(), (), 30.0, 7)
