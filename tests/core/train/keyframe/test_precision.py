"""Sensitivities against linear pictures, and the precision and the basis that follow from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from streamlod.core.scene.octree import Octree
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.convert import field_of, scene_of
from streamlod.core.train.field.decode import Network
from streamlod.core.train.field.field import Field
from streamlod.core.train.field.learned import ROW_PARAMETERS
from streamlod.core.train.field.rounding import Precision, usual_precision
from streamlod.core.train.keyframe.precision import (
    COARSEST,
    Sensitivity,
    measured_precision,
    row_shifts,
    sensitivity,
    signed_gradients,
    tuned_precision,
)

FEATURES, SLOTS, VIEWS = 6, 2, 40


def test_signed_gradients_say_how_the_squared_error_grows() -> None:
    """On pictures linear in the parameters their second moments are J^T J, up to what random signs leave."""
    generator = torch.Generator().manual_seed(0)
    mixing = torch.randn(2, 400, 6, generator=generator, dtype=torch.float64) * torch.logspace(-2, 1, 6).double()
    values = torch.randn(6, generator=generator, dtype=torch.float64)

    def draw(number: int, leaves: tuple[Tensor, ...]) -> Tensor:
        return (mixing[number] @ leaves[0]).reshape(20, 20, 1)

    trials = [
        torch.stack([g[0] ** 2 for g in signed_gradients((values,), draw, [0, 1], seed)]).sum(dim=0)
        for seed in range(200)
    ]
    torch.testing.assert_close(torch.stack(trials).mean(dim=0), mixing.square().sum(dim=(0, 1)), rtol=0.25, atol=0)


def test_rounding_costs_the_budget_and_spares_what_shows() -> None:
    cost = 10.0 ** (4 * torch.rand(500, generator=torch.Generator().manual_seed(1)) - 2)
    budget = 15 * float(cost.sum())
    shifts = row_shifts(cost, budget)
    assert 0.7 * budget < float((cost * 4.0**shifts).sum()) <= budget
    assert bool((shifts[torch.argsort(cost)].diff() <= 0).all())  # the more it shows, the finer


def test_what_nobody_sees_is_coarsest_and_no_budget_is_finest() -> None:
    cost = torch.cat([torch.zeros(3), torch.rand(20) + 1])
    assert row_shifts(cost, 60.0)[:3].tolist() == [COARSEST] * 3
    assert row_shifts(cost, 0.0)[3:].tolist() == [0] * 20
    assert row_shifts(torch.zeros(4), 1.0).tolist() == [COARSEST] * 4


def _field(rows: int) -> Field:
    generator = torch.Generator().manual_seed(2)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    mixed = normal(rows, FEATURES) @ (normal(FEATURES, FEATURES) * torch.logspace(-1, 0.5, FEATURES))
    side = torch.arange(rows, dtype=torch.int32)
    return Field(
        octree=Octree(np.zeros(3), 1.0, 1),
        reference_distance=1.0,
        view_dependent=False,
        level=torch.zeros(rows, dtype=torch.int64),
        voxel=torch.stack([side, side, side], dim=1),
        extra_level=torch.zeros(rows),
        position=normal(rows, 3),
        feature=mixed + 2,
        offset=normal(rows, SLOTS, 3),
        scaling=normal(rows, 6),
        network=Network(normal(FEATURES, 32), normal(32), normal(32, 11 * SLOTS), normal(11 * SLOTS)),
    )


def _found(field: Field) -> Sensitivity:
    """Gradients that differ a lot between anchors, and are far from white in every basis but one."""
    generator = torch.Generator().manual_seed(3)
    rows = 10.0 ** (2 * torch.rand(len(field), 1, generator=generator))
    shape = torch.randn(FEATURES, FEATURES, generator=generator)

    def views() -> list[tuple[Tensor, ...]]:
        sizes = (FEATURES, 3 * SLOTS, 6)
        drawn = [[rows * torch.randn(len(field), n, generator=generator) for n in sizes] for _ in range(VIEWS)]
        return [(f @ shape, o.reshape(-1, SLOTS, 3), s) for f, o, s in drawn]

    return sensitivity(iter(views()))


def _error(field: Field, found: Sensitivity, precision: Precision) -> float:
    """What rounding adds to the squared error, for anchors whose numbers do not act on the same pixels."""
    rounded = precision.rounded(field)
    feature, offset, scaling = (getattr(rounded, name) - getattr(field, name) for name in ROW_PARAMETERS)
    of_features = (found.feature * feature).sum(dim=2).square().sum()
    rest = (found.offset * offset**2).sum() + (found.scaling * scaling**2).sum()
    return float(of_features + rest)


def _bits(field: Field, precision: Precision) -> float:
    """Log2 of the spread of what is sent, in quanta: bits up to a constant."""
    sent = precision.sent(field)
    times = 2.0 ** precision.shift[:, None]
    quanta = [
        values.flatten(1) / width.flatten() / times
        for values, width in ((sent.feature, precision.feature), (sent.offset, precision.offset))
    ]
    return float(torch.cat([(q - q.mean(dim=0)).abs().mean(dim=0).log2() for q in quanta]).sum())


def test_the_measured_basis_takes_fewer_bits_for_the_same_error() -> None:
    field = _field(3000)
    found = _found(field)
    budget = 50.0 * len(field)
    precision = measured_precision(field, found, budget)
    assert 0.5 * budget < _error(field, found, precision) < 1.5 * budget
    plain = replace(precision, basis=torch.eye(FEATURES), inverse=torch.eye(FEATURES))
    plain = replace(plain, feature=plain.feature * (budget / _error(field, found, plain)) ** 0.5)
    for _ in range(6):  # widths of features alone, until the error is the same
        plain = replace(plain, feature=plain.feature * (budget / _error(field, found, plain)) ** 0.5)
    assert _bits(field, precision) < _bits(field, plain) - 2


@pytest.mark.parametrize("share", [0.3, 0.8, 2.5])
def test_one_anchor_that_rounding_throws_off_does_not_make_all_others_finer(share: float) -> None:
    """Steps a little too wide for it may add a hundred budgets, while others even take something away."""
    field = _field(1000)
    found, budget = _found(field), 50.0 * 1000

    def added(precision: Precision) -> float:
        return 100 * budget if _error(field, found, precision) > share * budget else -0.1 * budget

    error = _error(field, found, tuned_precision(field, found, budget, added))
    assert 0.6 * share * budget < error <= share * budget


def test_what_is_sent_decodes_to_what_was_rounded() -> None:
    field = _field(300)
    precision = measured_precision(field, _found(field), 50.0 * 300)
    rounded = precision.rounded(field)
    again = field_of(scene_of(field, PredictConfig(), (), 30.0, 0, precision))
    hidden = rounded.feature @ field.network.hidden_weight
    sent = again.feature @ again.network.hidden_weight
    order = again.voxel[:, 0].long()  # Morton order of a diagonal is its own
    scale = float(hidden.abs().max())
    torch.testing.assert_close(sent, hidden[order], atol=2e-3 * scale, rtol=0)  # the network travels in float16
    torch.testing.assert_close(again.offset, rounded.offset[order], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(again.scaling, rounded.scaling[order], atol=1e-5, rtol=1e-5)


def test_rows_are_rounded_to_their_own_steps() -> None:
    field = _field(6)
    field = replace(field, offset=field.offset.requires_grad_(), feature=field.feature.requires_grad_())
    precision = replace(usual_precision(field), shift=torch.arange(6))
    rounded = precision.rounded(field)
    for row in range(6):
        for name, step in zip(ROW_PARAMETERS, (0.025, 0.0125, 0.0125), strict=True):
            values, before = getattr(rounded, name), getattr(field, name)
            width = step * 2**row
            torch.testing.assert_close((values[row] / width).round() * width, values[row])
            assert float((values[row] - before[row]).detach().abs().max()) <= width / 2 + 1e-6
    (rounded.feature.sum() + rounded.offset.sum()).backward()  # type: ignore[no-untyped-call]
    for leaf in (field.feature, field.offset):
        assert leaf.grad is not None
        assert torch.equal(leaf.grad, torch.ones_like(leaf))


def test_features_that_do_nothing_and_single_anchors_have_a_precision() -> None:
    field = _field(1)
    found = _found(field)
    for silent in (found, replace(found, feature=0 * found.feature)):
        rounded = measured_precision(field, silent, 10.0).rounded(field)
        assert all(bool(getattr(rounded, name).isfinite().all()) for name in ROW_PARAMETERS)
    nothing = Sensitivity(0 * found.feature, 0 * found.offset, 0 * found.scaling)
    assert measured_precision(field, nothing, 10.0).shift.tolist() == [0]
