"""The trainer's decoding against the decoder's reference arithmetic."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.convert import field_of, level_starts, scene_of
from streamlod.core.train.field.decode import Network, decode
from tests.core.train.fields import random_field
from tests.core.train.references import decode_reference
from tests.threads import MAX_THREADS, kernel_threads


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


@pytest.mark.parametrize("view_dependent", [False, True])
@pytest.mark.parametrize(("count", "slots"), [(0, 4), (1, 4), (37, 1), (300, 4), (101, 10)])
def test_values_and_gradients_equal_the_reference(count: int, slots: int, view_dependent: bool) -> None:
    given = _inputs(count, slots, view_dependent)
    found, wanted = _outcome(_fused, given, torch.float32), _outcome(decode_reference, given, torch.float64)
    for name, mine, reference in zip(_PARTS + _GIVEN, found, wanted, strict=True):
        assert mine.shape == reference.shape
        assert float((mine - reference).norm()) <= 1e-5 * float(reference.norm()), name


def test_log_scales_beyond_their_limit_get_no_gradient() -> None:
    given = _inputs(6, 2, False)
    given[2][:, :] = torch.tensor([-25.0, -20.0, 20.0, 21.0, -1e9, 1e9])
    found, wanted = _outcome(_fused, given, torch.float32), _outcome(decode_reference, given, torch.float64)
    assert ((found[7] == 0) == (wanted[7] == 0)).all()
    for mine, reference in zip(found, wanted, strict=True):
        assert float((mine - reference).norm() / reference.norm()) < 1e-5


def test_a_broken_number_stays_broken_and_with_its_anchor() -> None:
    given = _inputs(5, 4, False)
    given[0][2, 1], given[2][3, 0], given[2][4, 4] = math.nan, math.nan, math.inf
    parts = [part.reshape(5, -1) for part in _fused(*given)]
    broken = torch.stack([~part.isfinite().all(dim=1) for part in parts], dim=1)
    assert broken[2].tolist() == [False, True, True, True, True]  # the means do not ask the network
    assert broken[3].tolist() == [True, False, False, False, False]
    assert not broken[[0, 1, 4]].any()


def test_gradients_are_the_same_for_any_number_of_threads() -> None:
    found = []
    for count in (1, MAX_THREADS):
        with kernel_threads(count):
            found.append(_outcome(_fused, _inputs(301, 4, False), torch.float32))
    assert all(torch.equal(one, other) for one, other in zip(*found, strict=True))


@pytest.mark.parametrize("count", [0, 1, 71])
def test_the_gradient_that_is_written_down_for_other_devices_equals_torch(count: int) -> None:
    given = _inputs(count, 4, False)
    given[2][:1, 1:4:2] = torch.tensor([-60.0, 60.0])  # held by the limits
    found, wanted = (_outcome(function, given, torch.float64) for function in (_fused, decode_reference))
    for mine, reference in zip(found, wanted, strict=True):
        torch.testing.assert_close(mine, reference, rtol=1e-9, atol=1e-12)


_PARTS = ("means", "quaternions", "scales", "opacities", "colours")
_GIVEN = ("inputs", "offset", "scaling", "position", "hidden weight", "hidden bias", "output weight", "output bias")


def _inputs(count: int, slots: int, view_dependent: bool) -> list[Tensor]:
    field = random_field(max(count, 1), slots, view_dependent=view_dependent, seed=count).with_rows(torch.arange(count))
    generator = torch.Generator().manual_seed(slots)
    inputs = torch.cat([field.feature, torch.randn(count, 4 * view_dependent, generator=generator)], dim=1)
    network = [value + 0.3 * torch.randn(value.shape, generator=generator) for value in field.network.parameters()]
    return [inputs, field.offset, field.scaling, field.position, *network]


def _fused(inputs: Tensor, offset: Tensor, scaling: Tensor, position: Tensor, *network: Tensor) -> tuple[Tensor, ...]:
    return decode(inputs, offset, scaling, position, Network(*network)).astuple()


def _outcome(function: Callable[..., tuple[Tensor, ...]], given: list[Tensor], dtype: torch.dtype) -> list[Tensor]:
    """The five parts, and the gradients of all that they are made of, by a loss that weighs every number anew."""
    leaves = [value.to(dtype).clone().requires_grad_() for value in given]
    parts, generator = function(*leaves), torch.Generator().manual_seed(5)
    weights = [torch.randn(part.shape, generator=generator) for part in parts]
    total = sum((part * weight.to(dtype)).sum() for part, weight in zip(parts, weights, strict=True))
    return [part.detach() for part in parts] + list(torch.autograd.grad(total, leaves))  # type: ignore[arg-type]


def _scene(view_dependent: bool, slots: int) -> Scene:
    field = random_field(anchors=60, slots=slots, view_dependent=view_dependent)
    return scene_of(field, PredictConfig(), (), 30.0, 7)
