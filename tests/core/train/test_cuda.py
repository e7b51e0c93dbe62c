"""Training on a GPU against the CPU; on the pretend device where there is no GPU (`tests.device`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from streamlod.core.metrics import psnr
from streamlod.core.render.cpu import render
from streamlod.core.scene.anchors import LATENTS, OFFSET_LATENTS
from streamlod.core.scene.expand import expand
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import PredictConfig, TrainConfig, Trainer
from streamlod.core.train.config import KeyframeConfig
from streamlod.core.train.field.decode import Network, decode
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.keyframe.random_background import over_colour
from streamlod.core.train.later_frame.apply import UnitChange, applied
from streamlod.core.train.later_frame.parts import USUAL
from streamlod.core.train.loss.penalty import penalty
from streamlod.core.train.loss.photometric import photometric_loss
from streamlod.core.train.optimise.adam import RowAdam
from streamlod.core.train.optimise.rate import residual_bits
from tests.core.train.fields import random_field
from tests.core.train.references import decode_reference, photometric_reference, residual_bits_reference
from tests.core.true_points import true_points

pytestmark = pytest.mark.cuda


def test_loss_equals_the_reference(gpu: str) -> None:
    image, target = torch.rand(90, 70, 3), torch.rand(90, 70, 3)
    there, here = image.to(gpu).requires_grad_(), image.double().requires_grad_()
    found, wanted = photometric_loss(there, target.to(gpu)), photometric_reference(here, target.double())
    (by_there,), (by_here,) = torch.autograd.grad(found, there), torch.autograd.grad(wanted, here)
    assert float(found.detach()) == pytest.approx(float(wanted.detach()), rel=1e-5)
    assert float((by_there.cpu() - by_here).norm() / by_here.norm()) < 1e-4


@pytest.mark.parametrize("count", [3, 500, 700])  # compiled once for all
def test_decode_equals_the_reference(count: int, gpu: str) -> None:
    field = random_field(min(count, 500))
    given = [field.feature, field.offset, field.scaling, field.position, *field.network.parameters()]
    there = [value.to(gpu).requires_grad_() for value in given]
    here = [value.double().requires_grad_() for value in given]
    found = decode(*there[:4], Network(*there[4:])).astuple()
    wanted = decode_reference(*here)
    _agree(found, wanted, there, here)


def test_residuals_are_applied_as_on_the_cpu(gpu: str) -> None:
    field, found = random_field(90), list[list[Tensor]]()
    values = [3 * torch.randn(90, LATENTS), 3 * torch.randn(90, 3)]
    parts = [torch.randn(LATENTS - OFFSET_LATENTS, 8), torch.randn(OFFSET_LATENTS, 12), torch.rand(90, 1)]
    for device in ("cpu", gpu):
        leaves = [value.to(device).requires_grad_() for value in values]
        after = applied(field.to(device), *leaves, UnitChange(*(part.to(device) for part in parts)))
        total = after.feature.sum() + after.offset.square().sum() + after.position.sum()
        found.append([after.feature, after.offset, *torch.autograd.grad(total, leaves)])
    for mine, theirs in zip(*found, strict=True):
        torch.testing.assert_close(mine, theirs.cpu(), rtol=1e-4, atol=1e-4)


def test_penalty_equals_the_cpu(gpu: str) -> None:
    scales, opacities, share, hiding = torch.rand(70, 3), torch.rand(70) - 0.3, torch.rand(70), torch.rand(70)
    opacities[0] = 0
    visible = torch.arange(0, 70, 3)

    def priced(*given: torch.Tensor) -> torch.Tensor:
        rows, *parts = (part.to(given[0].device) for part in (visible, share, hiding))
        return penalty(*given, rows, 0.3, 0.2, *parts)

    _equal_the_cpu(priced, (scales, opacities), gpu)


def test_exposures_equal_the_cpu(gpu: str) -> None:
    given = torch.rand(9, 7, 3), 1 + torch.rand(4, 3), torch.rand(4, 3)
    weight = torch.rand(9, 7, 3)
    _equal_the_cpu(lambda image, *of: (Exposure(*of).apply(image, 2) * weight.to(image)).sum(), given, gpu)


def test_random_backgrounds_equal_the_cpu(gpu: str) -> None:
    target, colour, weight = torch.rand(9, 7, 3) / 8, torch.rand(3), torch.rand(9, 7, 3)

    def weighed(image: Tensor, light: Tensor) -> Tensor:
        return (over_colour(image, light, target.to(image), colour.to(image)) * weight.to(image)).sum()

    _equal_the_cpu(weighed, (torch.rand(9, 7, 3), torch.rand(9, 7)), gpu)


def _equal_the_cpu(function: Callable[..., Tensor], given: tuple[Tensor, ...], gpu: str) -> None:
    """Value and gradients."""
    found = list[list[Tensor]]()
    for device in ("cpu", gpu):
        leaves = [value.to(device).requires_grad_() for value in given]
        value = function(*leaves)
        found.append([value.detach(), *torch.autograd.grad(value, leaves)])
    for here, there in zip(*found, strict=True):
        torch.testing.assert_close(here, there.cpu(), rtol=1e-4, atol=1e-6)


def test_rate_and_adam_equal_the_cpu(gpu: str) -> None:
    latent, position = 2 * torch.randn(50, LATENTS), 2 * torch.randn(50, 3)
    bits = residual_bits(latent.to(gpu), position.to(gpu))
    assert float(bits) == pytest.approx(float(residual_bits_reference(latent.double(), position.double())), rel=1e-3)
    ended = []
    for device in ("cpu", gpu):
        adam = RowAdam({"latent": latent.to(device).clone().requires_grad_()})
        for step in range(5):
            adam.parameters["latent"].grad = (latent * (step + 1)).to(device)
            adam.step({"latent": 0.1})
        ended.append(adam.parameters["latent"].detach().cpu())
    torch.testing.assert_close(*ended, rtol=1e-5, atol=1e-5)


@pytest.mark.slow
def test_frames_train_as_well_as_on_the_cpu(gpu: str) -> None:
    """In the mean of some seeds: one run that rounds differently may be 0.8 dB off."""
    spec = SyntheticSpec(cameras=3, frames=2, width=64, height=36, seed=2)
    clip = open_synthetic(spec)
    config = TrainConfig(
        keyframe=KeyframeConfig(steps=40), predict=PredictConfig(epochs=4, minimum_steps=0), parts=USUAL
    )
    filmed, points, camera = list(clip.frames()), true_points(spec), clip.cameras[0]
    truth, gains = filmed[-1].images[0].astype(np.float32) / 255, list[float]()
    for seed in range(4):
        scores = []
        for device in ("cpu", "cuda"):
            trainer = Trainer(clip.cameras, replace(config, seed=seed), clip.fps, device)
            trainer.keyframe(filmed[0], points)
            for frame in filmed[1:]:
                trainer.prepare(frame)
                trainer.predict(frame)
            image = render(expand(trainer.scene, camera.centre), camera, np.zeros(3, np.float32)).image
            scores.append(psnr(image.clip(0, 1), truth))
        gains.append(scores[1] - scores[0])
    assert np.mean(gains) > -0.5


def _agree(found: tuple[Tensor, ...], wanted: tuple[Tensor, ...], there: list[Tensor], here: list[Tensor]) -> None:
    weights = [torch.randn(part.shape) for part in wanted]
    totals = [
        torch.stack([(part * weight.to(part)).sum() for part, weight in zip(parts, weights, strict=True)]).sum()
        for parts in (found, wanted)
    ]
    mine = (*found, *torch.autograd.grad(totals[0], there))
    theirs = (*wanted, *torch.autograd.grad(totals[1], here))
    for one, other in zip(mine, theirs, strict=True):
        assert float((one.detach().cpu() - other.detach()).norm() / other.detach().norm()) < 1e-3
