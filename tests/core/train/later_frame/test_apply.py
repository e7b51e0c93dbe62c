"""Residuals onto anchors: what the reference makes of them, in values and gradients."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from streamlod.core.scene.anchors import LATENTS, OFFSET_LATENTS
from streamlod.core.train.field.field import Field
from streamlod.core.train.later_frame.apply import UnitChange, applied
from tests.core.train.fields import random_field
from tests.core.train.references import applied_reference

NAMES = ("feature", "offset", "position")


@pytest.mark.parametrize("slots", [1, 4])
@pytest.mark.parametrize("count", [0, 1, 90])
def test_values_and_gradients_equal_the_reference(count: int, slots: int) -> None:
    ours, reference = _outcome(applied, count, slots), _outcome(applied_reference, count, slots)
    for found, wanted in zip(ours, reference, strict=True):
        torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-5)


def test_what_is_not_changed_stays_as_it_was() -> None:
    field, latent, position, quantum = _case(50, 4)
    latent[:, :] = 0.3  # all within the dead zone
    position[:, :] = -0.3
    same = applied(field, latent, position, quantum)
    assert all(torch.equal(getattr(same, name), getattr(field, name)) for name in NAMES)


def _outcome(function: Callable[..., Field], count: int, slots: int) -> list[Tensor]:
    field, latent, position, quantum = _case(count, slots)
    leaves = [latent.requires_grad_(), position.requires_grad_()]
    after, generator = function(field, *leaves, quantum), torch.Generator().manual_seed(3)
    parts = [getattr(after, name) for name in NAMES]
    weighted = [(part * torch.randn(part.shape, generator=generator)).sum() for part in parts]
    return [part.detach() for part in parts] + list(torch.autograd.grad(torch.stack(weighted).sum(), leaves))


def _case(count: int, slots: int) -> tuple[Field, Tensor, Tensor, UnitChange]:
    field, generator = random_field(max(count, 1), slots).with_rows(torch.arange(count)), torch.Generator()
    generator.manual_seed(count)

    def random(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    features = field.feature.shape[1]
    decoders = random(LATENTS - OFFSET_LATENTS, features), random(OFFSET_LATENTS, 3 * slots)
    quantum = UnitChange(*decoders, random(count, 1).abs())
    return field, 3 * random(count, LATENTS), 3 * random(count, 3), quantum
