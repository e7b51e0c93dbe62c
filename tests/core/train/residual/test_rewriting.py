"""Anchors that are sent anew: as they were trained, with what was known of them, and worth it where things go far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.camera import look_at, pinhole
from streamlod.core.scene.residual import apply
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.convert import field_of, level_starts, scene_of
from streamlod.core.train.field.exposure import neutral
from streamlod.core.train.field.rendered import rendered
from streamlod.core.train.growth.later import AnchorAllowance, ByError
from streamlod.core.train.motion.partition import Partition
from streamlod.core.train.pictures.views import Views
from streamlod.core.train.residual.rewriting import pull_of, rewritten_anchors, values_of
from streamlod.core.train.residual.state import State, fresh_state
from streamlod.core.train.residual.trainer import ResidualTrainer
from streamlod.core.train.residual.update import IntegerUpdate, residual_of, strongest_changes
from tests.core.train.fields import random_field

WIDTH, HEIGHT = 96, 64
CONFIG = PredictConfig(
    epochs=15,
    minimum_steps=0,
    least_gain=0.0,
    rate_weight=0.0005,
    growth_at=0.2,
    rewritten_pixels=0.0,
)
CAMERAS = tuple(
    pinhole(f"cam{i}", (WIDTH, WIDTH), (WIDTH / 2, HEIGHT / 2), (WIDTH, HEIGHT),
            look_at(np.array([x, -0.4, -3.0]), np.zeros(3), np.array([0.0, -1.0, 0.0])))
    for i, x in enumerate((-0.6, -0.2, 0.2, 0.6))
)  # fmt: skip
SCENE = scene_of(random_field(200), CONFIG, CAMERAS, 30.0, 0)


def trained(
    share: float, price: float = 0.0, new: int = 0, pixels: float = 0.0
) -> tuple[ResidualTrainer, IntegerUpdate, State, Views]:
    """A frame in which every Gaussian has become a third larger, which no residual can say; `price` of a bit."""
    state = fresh_state(SCENE, "cpu")
    blank = Views(CAMERAS, torch.zeros(4, HEIGHT, WIDTH, 3), [0, 1, 2, 3])
    grown = replace(state.field, scaling=state.field.scaling + np.log(4 / 3))
    views = replace(blank, targets=rendered(grown, state.alive, blank, "cpu"))
    everything = Partition(None, np.ones(len(state.field), np.bool_))
    masks = torch.ones(4, HEIGHT, WIDTH, dtype=torch.bool)
    trainer = ResidualTrainer(state, everything, views, neutral(4), masks, [0, 1, 2, 3])
    config, allowance = replace(CONFIG, rewritten_share=share, rewritten_pixels=pixels), AnchorAllowance(new, 1000)
    update = trainer.run(config, "cpu", torch.Generator().manual_seed(0), growth=ByError(price), allowance=allowance)
    return trainer, update, state, views


def test_what_is_decoded_is_what_was_trained() -> None:
    trainer, update, state, _ = trained(0.2)
    assert update.new == 40
    assert update.heirs is not None
    rows = torch.arange(len(state.field))
    after = apply(SCENE, residual_of(SCENE, rows.numpy(), update, 1))
    assert after.anchor_count == SCENE.anchor_count - update.removed.sum() + 40
    decoded, starts = field_of(after), level_starts(after)
    sizes = [len(level) for level in SCENE.levels]
    new = torch.cat([torch.arange(starts[i] + size, starts[i + 1]) for i, size in enumerate(sizes)])
    sent = trainer._anchors.field()
    wanted = sent.with_rows(torch.arange(len(sent) - 40, len(sent)))
    order = torch.argsort(wanted.level, stable=True)
    for name in ("feature", "offset", "scaling", "position", "extra_level"):
        one, other = (getattr(field, name).detach() for field in (decoded.with_rows(new), wanted.with_rows(order)))
        torch.testing.assert_close(one, other, atol=2e-4, rtol=0)
    assert len(np.unique(update.heirs)) == 40
    assert update.removed[update.heirs].all()


def test_sizes_that_no_residual_can_say_are_shown_better() -> None:
    errors = []
    for share in (0.0, 0.5):
        _, update, state, views = trained(share)
        after = fresh_state(apply(SCENE, residual_of(SCENE, np.arange(len(state.field)), update, 1)), "cpu")
        shown = rendered(after.field, after.alive, views, "cpu")
        errors.append(float((shown.clamp(0, 1) - views.targets).square().mean()))
        assert (update.new > 0) == (share > 0)
    assert errors[1] < 0.8 * errors[0]


def test_an_heir_keeps_what_was_known_of_the_one_before() -> None:
    _, update, state, _ = trained(0.2)
    rows = torch.arange(len(state.field))
    assert update.heirs is not None
    residual = residual_of(SCENE, rows.numpy(), update, 1)
    start = 0.5 * update.sent
    after = state.after(residual, apply(SCENE, residual), Partition(None, rows.numpy() >= 0), rows, update, start)
    sizes, starts = [len(level) for level in SCENE.levels], level_starts(after.scene)
    new = np.concatenate([np.arange(starts[i] + size, starts[i + 1]) for i, size in enumerate(sizes)])
    assert after.change is not None
    assert after.start is not None
    np.testing.assert_array_equal(after.change.numpy()[new], update.sent[update.heirs])
    np.testing.assert_array_equal(after.start.numpy()[new], start[update.heirs])
    assert np.abs(update.position[update.removed]).max() >= 1  # they have gone somewhere


def test_no_more_than_three_are_rewritten_beside_one_that_is_added() -> None:
    counts = []
    for allowed in (3, 10):
        _, update, _, _ = trained(0.5, new=allowed)
        assert update.heirs is not None
        counts.append((int((update.heirs < 0).sum()), int((update.heirs >= 0).sum())))
    (few, beside_few), (some, beside_some) = counts
    assert few <= 3 < beside_few / 3  # three may be added: that few are says nothing
    assert 16 <= beside_some <= 3 * some <= 30


def test_what_has_not_gone_far_is_not_rewritten() -> None:
    assert trained(0.5, pixels=1e3)[1].new == 0


def test_an_heir_begins_the_next_frame_without_what_it_has_been_sent() -> None:
    _, update, _, _ = trained(0.2)
    assert update.heirs is not None
    before = np.ones_like(update.sent)
    for one in (update, strongest_changes(update, 100, np.ones(len(before), np.bool_))):
        done, cut = (one.continued(0.5, before, done=done)[update.heirs] for done in (True, False))
        np.testing.assert_array_equal(cut, done)
        np.testing.assert_array_equal(one.position[update.heirs], update.position[update.heirs])


def test_what_is_not_worth_its_bits_is_not_rewritten() -> None:
    free, fair, dear = (trained(0.5, price)[1].new for price in (0.0, 0.005, 0.02))
    assert free > fair > dear == 0


def test_those_that_go_far_are_rewritten_if_they_pull_hard() -> None:
    far = torch.arange(100) % 2 == 0
    pull = torch.randperm(100, generator=torch.Generator().manual_seed(0)).float()
    strongest = sorted(range(0, 100, 2), key=lambda row: -pull[row])
    assert rewritten_anchors(far, 20, 0.0, lambda: pull).tolist() == sorted(strongest[:20])
    worth = sorted(row for row in strongest if pull[row] > 30)
    assert rewritten_anchors(far, 100, 30.0, lambda: pull).tolist() == worth
    assert rewritten_anchors(far, 100, float(pull[strongest[15]]), lambda: pull).tolist() == []  # 15 are too few
    assert rewritten_anchors(far, 100, 0.0, lambda: 0 * pull).tolist() == []  # nobody sees them


def _unasked() -> torch.Tensor:
    raise AssertionError("nothing is to be rewritten")


@pytest.mark.parametrize(("going", "most"), [(50, 0), (50, 15), (15, 100), (0, 100)])
def test_nobody_is_asked_where_few_would_be_rewritten(going: int, most: int) -> None:
    assert rewritten_anchors(torch.arange(100) < going, most, 0.0, _unasked).tolist() == []


def test_the_pull_is_what_a_step_would_gain() -> None:
    field = random_field(30)
    weight = torch.rand(len(field), generator=torch.Generator().manual_seed(2))
    found = pull_of(field, lambda number, leaves: (number + 1) * (leaves.scaling.sum(dim=1) * weight).sum(), [0, 1])
    torch.testing.assert_close(found, 3 * 0.03 * 6 * weight)


def test_they_take_the_node_that_is_nearest() -> None:
    field = random_field(30)
    voxel = field.voxel.clone()
    rows = torch.tensor([3, 20])
    for row in rows:  # back to where they came from, after they have moved by a cell
        voxel[row] = torch.where(voxel[row] > 0, voxel[row] - 1, voxel[row] + 1)
    cells = field.octree.root_cell / 2.0 ** field.level.double()
    origin = torch.from_numpy(field.octree.origin)
    place = (origin + (field.voxel + 0.3) * cells[:, None]).float()
    values = values_of(replace(field, voxel=voxel, position=place), rows)
    within = [field.level == level for level in field.level[rows]]
    wanted = [
        torch.minimum(torch.maximum(field.voxel[row], voxel[same].amin(dim=0)), voxel[same].amax(dim=0))
        for row, same in zip(rows, within, strict=True)
    ]
    assert torch.equal(values["voxel"], torch.stack(wanted))
    assert torch.equal(values["feature"], field.feature[rows])


def test_an_anchor_that_is_lost_does_not_stretch_the_grid() -> None:
    field = random_field(30)
    lost = field.position.clone()
    lost[3], lost[4] = 1e9, torch.nan
    values = values_of(replace(field, position=lost), torch.tensor([3, 4]))
    for level, voxel in zip(values["level"], values["voxel"], strict=True):
        others = field.voxel[field.level == level]
        assert (voxel >= others.amin(dim=0)).all()
        assert (voxel <= others.amax(dim=0)).all()
