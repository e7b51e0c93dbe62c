"""The trainer's kernels against what torch makes of the same formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from streamlod.core.camera import pinhole
from streamlod.core.scene.anchors import LATENTS
from streamlod.core.train.growth.depth_search import matched_pixels
from streamlod.core.train.kernels import adam, decode, rate, windows
from streamlod.core.train.optimise.adam import RowAdam, update, update_all
from streamlod.core.train.optimise.rate import residual_bits
from streamlod.core.train.pictures.views import Views
from streamlod.server.pipeline.warming import warm_trainer
from tests.core.train.fields import random_field
from tests.core.train.references import residual_bits_reference, update_reference
from tests.threads import MAX_THREADS, kernel_threads


@pytest.mark.parametrize("count", [1, 7, 4099])
def test_adam_equals_torch_step_by_step(count: int) -> None:
    generator = torch.Generator().manual_seed(count)
    start = torch.randn(count, generator=generator)
    ours, theirs = ([start.clone(), torch.zeros(count), torch.zeros(count)] for _ in range(2))
    for step in range(1, 30):
        gradient = torch.randn(count, generator=generator) * 10.0 ** torch.randint(-8, 8, (count,), generator=generator)
        if step == 5:
            gradient[0] = math.nan
            gradient[-1] = -math.inf
        rate, correction2 = 0.1 / (1 - 0.9**step), 1 - 0.999**step
        broken = update([ours[0]], [gradient], [ours[1:]], [rate], [correction2])
        assert broken == update_reference(theirs[0], gradient, theirs[1], theirs[2], rate, correction2)
        assert int(broken) == (min(count, 2) if step == 5 else 0)
    for found, wanted in zip(ours, theirs, strict=True):
        torch.testing.assert_close(found, wanted, rtol=2e-6, atol=1e-6)


def test_adam_of_many_at_once_equals_one_by_one() -> None:
    generator = torch.Generator().manual_seed(3)
    shapes, rates = ((5, 3), (7,), (0, 2), (2, 2, 2)), [0.1, 0.02, 0.3, 0.004]
    sets = [[torch.randn(shape, generator=generator, dtype=torch.float64) for shape in shapes]]
    sets += [[torch.zeros_like(value) for value in sets[0]] for _ in range(2)]
    ours, theirs = ([[value.clone() for value in values] for values in sets] for _ in range(2))
    for step in range(1, 6):
        gradients = [torch.randn(value.shape, generator=generator, dtype=torch.float64) for value in ours[0]]
        if step == 3:
            gradients[0][0, :2] = torch.tensor([math.nan, math.inf])
        moments = [list(pair) for pair in zip(*ours[1:], strict=True)]
        corrections = [1 - 0.999 ** (step + late) for late in range(len(shapes))]
        broken = update_all(ours[0], gradients, moments, rates, corrections)
        rows = zip(*theirs, gradients, rates, corrections, strict=True)
        wanted = sum(update_reference(v, g, m, n, rate, correction) for v, m, n, g, rate, correction in rows)
        assert int(broken) == int(wanted) == (2 if step == 3 else 0)
    for found, one_by_one in zip(ours, theirs, strict=True):
        for mine, reference in zip(found, one_by_one, strict=True):
            torch.testing.assert_close(mine, reference, rtol=1e-12, atol=1e-14)


def test_parameters_that_join_a_run_begin_their_own() -> None:
    generator = torch.Generator().manual_seed(2)
    start, later = (torch.randn(6, 3, generator=generator) for _ in range(2))
    adam = RowAdam({"start": start.clone().requires_grad_()})
    for step in range(6):
        if step == 3:
            adam.join({"later": later.clone().requires_grad_()})
        for value in adam.parameters.values():
            value.grad = value.detach() * (step % 3 + 1)
        adam.step({"start": 0.1, "later": 0.1})
    alone = RowAdam({"later": later.clone().requires_grad_()})
    for step in range(3):
        alone.parameters["later"].grad = alone.parameters["later"].detach() * (step + 1)
        alone.step({"later": 0.1})
    assert torch.equal(adam.parameters["later"], alone.parameters["later"])


def test_adam_is_the_same_for_any_number_of_threads() -> None:
    found = []
    for count in (1, MAX_THREADS):
        value, first, second = torch.ones(1001), torch.zeros(1001), torch.zeros(1001)
        with kernel_threads(count):
            update([value], [torch.linspace(-1, 1, 1001)], [[first, second]], [0.1], [0.001])
        found.append(value)
    assert all(torch.equal(found[0], other) for other in found)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])  # the numba kernel, and what other devices run
@pytest.mark.parametrize("size", [0.0, 0.3, 3.0, 100.0])
@pytest.mark.parametrize("count", [0, 1, 900])
def test_rate_equals_torch(count: int, size: float, dtype: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(1)
    energy = size * torch.rand(count, 1, generator=generator) ** 2
    values = [(energy * torch.randn(count, channels, generator=generator)).to(dtype) for channels in (LATENTS, 3)]
    bits, gradients = [], []
    for function in (residual_bits, residual_bits_reference):
        leaves = [value.clone().requires_grad_() for value in values]
        total = function(*leaves)
        (0.5 * total).backward()
        bits.append(float(total.detach()))
        gradients.append([leaf.grad for leaf in leaves])
    assert bits[0] == pytest.approx(bits[1], rel=1e-5)
    for found, wanted in zip(*gradients, strict=True):
        assert found is not None
        assert wanted is not None
        # a value whose expected magnitude lies on the edge of a bin may fall on either side
        assert (found - wanted).abs().gt(1e-5).sum() <= found.numel() / 1000


def test_rate_of_broken_values_stays_in_its_table() -> None:
    latent = torch.zeros(4, LATENTS)
    latent[0, :3] = torch.tensor([math.nan, math.inf, -1e30])
    position = torch.zeros(4, 3, requires_grad=True)
    bits = residual_bits(latent.requires_grad_(), position)
    bits.backward()
    assert latent.grad is not None
    assert not latent.grad[0, :3].any() or bits.isnan()


def test_warming_compiles_what_training_uses() -> None:
    warm_trainer()
    kernels = (adam.adam_step, rate.residual_bits, decode.activate, decode.differentiate, windows.best_depths)
    signatures = [len(kernel.signatures) for kernel in kernels]
    value, moments = torch.ones(3, 2), [torch.zeros(3, 2), torch.zeros(3, 2)]
    update([value], [torch.ones(3, 2)], [moments], [0.1], [0.001])
    residual_bits(torch.ones(3, LATENTS), torch.ones(3, 3))
    field = random_field(6)
    field.network.hidden_weight.requires_grad_()
    field.decode(torch.zeros(3)).means.sum().backward()  # type: ignore[no-untyped-call]
    camera = pinhole("cam00", (8.0, 8.0), (4.0, 3.0), (8, 6), np.eye(4))
    views = Views((camera, camera), torch.rand(2, 6, 8, 3), [0, 1])
    rows, columns = np.nonzero(np.ones((6, 8)))
    matched_pixels(random_field(6), views, 0, rows * 1, columns * 1)
    assert [len(kernel.signatures) for kernel in kernels] == signatures
