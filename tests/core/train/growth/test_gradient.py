"""Growing, pruning, levels and the optimiser behind them."""

from __future__ import annotations

import numpy as np
import torch
from torch.optim.adam import adam

from streamlod.core.render.raster import Probe
from streamlod.core.train.config import KeyframeConfig
from streamlod.core.train.growth.gradient import GrowthStatistics, grow
from streamlod.core.train.optimise.adam import RowAdam
from streamlod.core.train.optimise.schedule import dropout_keep, unlocked_level, view_order
from tests.core.train.fields import random_field

THRESHOLD = 1.0
MANY = 10_000
ALIKE = torch.ones(())


def test_new_anchors_stand_on_free_nodes_near_the_gaussian_that_asked() -> None:
    field = random_field(90)
    gradient = torch.zeros(len(field) * field.slots)
    asking = torch.arange(0, len(gradient), 7)
    gradient[asking] = 1.05 * 2 ** (0.2 * field.level[asking // field.slots].float())
    new = grow(field, gradient, THRESHOLD, highest=2, most=MANY)
    assert len(new) > 0
    assert np.isin(new.parent, (asking // field.slots).numpy()).all()
    np.testing.assert_array_equal(new.level, field.level.numpy()[new.parent])
    taken = {(int(lv), *map(int, v)) for lv, v in zip(field.level, field.voxel, strict=True)}
    added = [(int(lv), *map(int, v)) for lv, v in zip(new.level, new.voxel, strict=True)]
    assert not taken & set(added)
    assert len(set(added)) == len(added)
    means = field.position[:, None] + field.offset * field.scaling.exp()[:, None, :3]
    for level, voxel, parent in zip(new.level, new.voxel, new.parent, strict=True):
        node = field.octree.node_of(voxel, int(level))
        assert np.abs(means[parent].numpy() - node).max(axis=1).min() <= 0.5001 * field.octree.cell(int(level))


def test_strong_gradients_grow_one_level_finer_but_never_past_the_highest() -> None:
    field = random_field(60)
    gradient = torch.full((len(field) * field.slots,), 100.0)
    assert grow(field, gradient, THRESHOLD, highest=2, most=MANY).level.max() == 2
    assert grow(field, gradient, THRESHOLD, highest=1, most=MANY).level.max() == 1
    assert len(grow(field, torch.zeros_like(gradient), THRESHOLD, highest=2, most=MANY)) == 0


def test_of_more_than_may_grow_those_that_pull_hardest_do() -> None:
    field = random_field(60)
    gradient = torch.linspace(10.0, 20.0, len(field) * field.slots)
    every, some = (grow(field, gradient, THRESHOLD, highest=2, most=most) for most in (MANY, 7))
    assert len(every) > 7
    assert sorted(some.parent) == sorted(every.parent)[-7:]


def test_only_anchors_seen_often_are_called_faint() -> None:
    statistics, one = GrowthStatistics(3, 2, torch.device("cpu")), Probe(torch.tensor([0]))
    one.record(torch.tensor([[0.6, 0.8]]))
    for _ in range(10):
        statistics.add(one, torch.tensor([0.4, 0.6, 1e-4, -0.5]), torch.tensor([0, 1]))
    statistics.add(one, torch.tensor([1e-4, -0.5]), torch.tensor([2]))
    assert statistics.faint(0.005).tolist() == [False, True, False]
    mean = statistics.mean_gradient()
    assert mean[0] == 1.0
    assert mean[4] == 0.0  # seen once in ten: not believed


def test_row_adam_equals_torch_adam() -> None:
    generator = torch.Generator().manual_seed(0)
    start = torch.randn(5, 3, generator=generator)
    mine, theirs, moments = start.clone().requires_grad_(), start.clone(), torch.zeros(2, 5, 3)
    optimiser, steps = RowAdam({"x": mine}), torch.tensor(0.0)
    for _ in range(20):
        (mine**2).sum().backward()
        optimiser.step({"x": 0.1})
        adam(  # the function alone: torch.optim.Adam loads torch's compiler, which takes longer than all of this file
            [theirs], [2 * theirs], [moments[0]], [moments[1]], [], [steps], beta1=0.9, beta2=0.999, lr=0.1, eps=1e-15,
            weight_decay=0.0, amsgrad=False, maximize=False, foreach=False,
        )  # fmt: skip
    torch.testing.assert_close(mine, theirs)


def test_row_adam_keeps_the_moments_of_rows_that_stay() -> None:
    whole, part = torch.ones(4, 2).requires_grad_(), torch.ones(2, 2).requires_grad_()
    first, second = RowAdam({"x": whole}), RowAdam({"x": part})
    for optimiser, value in ((first, whole), (second, part)):
        (3 * value).sum().backward()
        optimiser.step({"x": 0.1})
    first.replace_rows(torch.tensor([0, 2]), {"x": torch.zeros(1, 2)})
    for optimiser in (first, second):
        value = optimiser.parameters["x"]
        (value[:2] ** 2).sum().backward()
        optimiser.step({"x": 0.1})
    torch.testing.assert_close(first.parameters["x"][:2], second.parameters["x"])
    torch.testing.assert_close(first.parameters["x"][2:], torch.zeros(1, 2))


def test_broken_gradients_are_counted_and_change_nothing() -> None:
    value = torch.ones(3, requires_grad=True)
    optimiser = RowAdam({"x": value})
    value.grad = torch.tensor([1.0, float("nan"), float("inf")])
    optimiser.step({"x": 0.1})
    assert optimiser.broken == 2
    assert torch.isfinite(value).all()
    assert value[1:].tolist() == [1.0, 1.0]


def test_dropout_keeps_the_mean_and_grows_with_the_level() -> None:
    generator = torch.Generator().manual_seed(1)
    config = KeyframeConfig(dropout_base=0.1, dropout_slope=0.05)
    for level, rate in ((0, 0.1), (3, 0.25), (50, 0.5)):
        keep = dropout_keep(torch.full((40_000,), level), 51, config, 1.0, generator, ALIKE)
        assert abs(float((keep == 0).float().mean()) - rate) < 0.01
        assert abs(float(keep.mean()) - 1) < 0.02
    assert (dropout_keep(torch.full((100,), 3), 4, config, 0.0, generator, ALIKE) == 1).all()


def test_levels_unlock_in_shrinking_intervals() -> None:
    config = KeyframeConfig(progressive_until=0.5)
    unlocked = [unlocked_level(6, config, progress) for progress in np.linspace(0, 0.6, 601)]
    changes = np.flatnonzero(np.diff(unlocked)) * 0.001
    assert unlocked[0] == 3
    assert unlocked[-1] == 5
    assert len(changes) == 2
    assert changes[0] > changes[1] - changes[0] > 0
    assert abs(changes[1] - 0.5) < 0.002
    assert unlocked_level(1, config, 0.0) == 0


def test_every_view_comes_once_an_epoch() -> None:
    order = view_order([3, 5, 7], torch.Generator().manual_seed(2))
    for _ in range(4):
        assert sorted(next(order) for _ in range(3)) == [3, 5, 7]
