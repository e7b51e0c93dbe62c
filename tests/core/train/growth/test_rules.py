"""A growth rule is one object, found by its name: a toy one takes part in training without any other change."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from streamlod.core.errors import InputError
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import KeyframeConfig, PredictConfig, Trainer, preset
from streamlod.core.train.field.field import Field
from streamlod.core.train.growth import later, rules
from streamlod.core.train.growth.gradient import GrowthStatistics, NewAnchors
from tests.core.true_points import true_points


@dataclass(frozen=True)
class DropTheFirst:
    """A toy: each refinement removes the first anchor and adds none."""

    threshold: float = 0.0
    prune_opacity: float = 0.0
    extra_level_gain: float = 0.0

    def new_anchors(
        self, field: Field, statistics: GrowthStatistics, highest: int, most: int, occupied: Field | None = None
    ) -> NewAnchors:
        return NewAnchors(np.zeros((0, 3), np.int32), np.zeros(0, np.int64), np.zeros(0, np.int64))

    def extra_levels(self, field: Field, statistics: GrowthStatistics) -> torch.Tensor:
        return torch.zeros(len(field))

    def removed(self, statistics: GrowthStatistics) -> torch.Tensor:
        return torch.arange(len(statistics.visits)) == 0


def test_a_toy_rule_refines_the_first_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(rules.GROWTH_RULES, "drop the first", DropTheFirst)
    spec = SyntheticSpec(cameras=3, frames=1, width=96, height=56, seed=1)
    clip = open_synthetic(spec)
    (frame,) = clip.frames()
    points = true_points(spec)
    counts = []
    for growth_until in (0.0, 0.9):  # never, and after steps 5, 10 and 15 of 20
        config = preset("live")
        keyframe = replace(
            config.keyframe,
            **{"steps": 20, "growth_interval": 5, "growth_from": 0.1, "growth_until": growth_until, "clearance": 0.0},
            growth_rule="drop the first",
        )
        config = replace(config, keyframe=keyframe, model=replace(config.model, levels=2, finer_levels=0))
        counts.append(Trainer(clip.cameras, config, clip.fps, "cpu").keyframe(frame, points).scene.anchor_count)
    assert counts[1] == counts[0] - 3


def test_the_rule_takes_its_settings_from_the_configuration() -> None:
    first = KeyframeConfig(growth_threshold=1.0, prune_opacity=2.0, extra_level_gain=3.0)
    assert rules.growth_rule(first) == rules.GradientGrowth(1.0, 2.0, 3.0)
    assert later.later_growth(PredictConfig(growth_rule="gradient", growth_threshold=4.0)) == later.ByGradient(4.0)
    assert later.later_growth(PredictConfig(rate_weight=7.0)) == later.ByError(5.0)


def test_an_unknown_rule_is_refused_and_the_known_are_named() -> None:
    with pytest.raises(InputError, match="choose one of gradient"):
        rules.growth_rule(KeyframeConfig(growth_rule="random"))
    with pytest.raises(InputError, match="choose one of error, gradient"):
        later.later_growth(PredictConfig(growth_rule="random"))
