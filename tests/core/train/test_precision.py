"""Sensitivities against finite differences, and the precision that follows from them."""

from __future__ import annotations

import torch
from torch import Tensor

from core.train.precision import COARSEST, row_shifts, sensitivities
from core.train.rounding import Steps


def test_sensitivities_are_the_squared_error_of_a_small_change() -> None:
    """On pictures linear in the parameters the estimate is the exact diagonal, up to what random signs leave."""
    generator = torch.Generator().manual_seed(0)
    mixing = torch.randn(2, 400, 6, generator=generator, dtype=torch.float64) * torch.logspace(-2, 1, 6).double()
    values = torch.randn(6, generator=generator, dtype=torch.float64)

    def draw(number: int, leaves: tuple[Tensor, ...]) -> Tensor:
        return (mixing[number] @ leaves[0]).reshape(20, 20, 1)

    trials = [sensitivities((values,), draw, [0, 1], seed)[0] for seed in range(200)]
    torch.testing.assert_close(torch.stack(trials).mean(dim=0), mixing.square().sum(dim=(0, 1)), rtol=0.25, atol=0)


def _found(rows: int) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    scale = 10.0 ** (4 * torch.rand(rows, 1, generator=generator) - 2)
    return scale.repeat(1, 16), scale[:, None].repeat(1, 4, 3), scale.repeat(1, 6)


def test_rounding_costs_the_budget_and_spares_what_shows() -> None:
    found, steps = _found(500), Steps()
    finest = [float(h.sum() * width**2 / 12) for h, width in zip(found, (0.025, 0.0125, 0.0125), strict=True)]
    budget = 15 * sum(finest)
    shifts = row_shifts(found, steps, budget)
    spent = sum(
        float((h.flatten(1) * (width * 2.0 ** shifts[:, None]) ** 2 / 12).sum())
        for h, width in zip(found, (steps.feature, steps.offset, steps.scaling), strict=True)
    )
    assert 0.7 * budget < spent <= budget
    order = torch.argsort(found[0][:, 0])
    assert bool((shifts[order].diff() <= 0).all())  # the more it shows, the finer
    assert set(shifts.tolist()) == set(range(COARSEST + 1))


def test_what_nobody_sees_is_coarsest_and_no_budget_is_finest() -> None:
    found = tuple(torch.cat([torch.zeros_like(h[:3]), h]) for h in _found(20))
    feature, offset, scaling = found
    assert row_shifts((feature, offset, scaling), Steps(), 3.0)[:3].tolist() == [COARSEST] * 3
    assert row_shifts(_found(20), Steps(), 0.0).tolist() == [0] * 20
    nothing = tuple(torch.zeros_like(h) for h in _found(4))
    assert row_shifts((nothing[0], nothing[1], nothing[2]), Steps(), 1.0).tolist() == [COARSEST] * 4


def test_rows_are_rounded_to_their_own_steps() -> None:
    generator = torch.Generator().manual_seed(2)
    feature, scaling = torch.randn(6, 16, generator=generator), torch.randn(6, 6, generator=generator)
    offset = torch.randn(6, 4, 3, generator=generator).requires_grad_()
    shift = torch.arange(6)
    rounded = Steps().rounded(feature, offset, scaling, shift)
    for row in range(6):
        for values, before, step in zip(rounded, (feature, offset, scaling), (0.025, 0.0125, 0.0125), strict=True):
            width = step * 2**row
            torch.testing.assert_close((values[row] / width).round() * width, values[row])
            assert float((values[row] - before[row]).detach().abs().max()) <= width / 2 + 1e-6
    rounded[1].sum().backward()  # type: ignore[no-untyped-call]
    assert offset.grad is not None
    assert torch.equal(offset.grad, torch.ones_like(offset))
