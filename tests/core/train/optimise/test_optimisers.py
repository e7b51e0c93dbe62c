"""An optimiser is one object, found by its name: a toy one takes part in training without any other change."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import pytest
import torch
from torch import Tensor

from streamlod.core.errors import InputError
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer, preset
from streamlod.core.train.optimise import optimisers
from tests.core.true_points import true_points


@dataclass
class NoSteps:
    """Counts steps and takes none."""

    parameters: dict[str, Tensor]
    made: list[int]
    broken: int = 0

    def step(self, rates: dict[str, float]) -> None:
        self.made.append(len(rates))
        for value in self.parameters.values():
            value.grad = None

    def join(self, parameters: dict[str, Tensor]) -> None:
        self.parameters.update(parameters)

    def replace_rows(self, kept: Tensor, added: dict[str, Tensor]) -> None:
        for name, rows in added.items():
            self.parameters[name] = torch.cat([self.parameters[name].detach()[kept], rows]).requires_grad_()


@dataclass(frozen=True)
class Lazy:
    """A toy: parameters stay where they are."""

    memory: float = 0.0
    made: list[int] = field(default_factory=list)

    def start(self, parameters: dict[str, Tensor]) -> NoSteps:
        return NoSteps(parameters, self.made)


def test_a_toy_optimiser_trains_both_kinds_of_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    lazy = Lazy()
    monkeypatch.setitem(optimisers.OPTIMISERS, "lazy", lambda memory: lazy)
    spec = SyntheticSpec(cameras=3, frames=2, width=96, height=56, seed=1)
    clip = open_synthetic(spec)
    first, second = clip.frames()
    config = preset("live")
    config = replace(
        config,
        keyframe=replace(config.keyframe, steps=20, optimiser="lazy"),
        predict=replace(
            config.predict,
            optimiser="lazy",
            epochs=1,
            minimum_steps=4,
            least_gain=0.0,
            growth_share=0.0,  # new anchors have an optimiser of their own
            search_from=0.0,  # finds changes before any optimiser
        ),
    )
    trainer = Trainer(clip.cameras, config, clip.fps, "cpu")
    trainer.keyframe(first, true_points(spec))
    assert len(lazy.made) == 20
    trained = trainer.predict(second)
    assert len(lazy.made) == 20 + trained.report.steps
    assert trained.report.steps == 4
    assert trained.residual is not None
    assert trained.residual.changed == 0


def test_an_unknown_optimiser_is_refused_and_the_known_are_named() -> None:
    assert optimisers.optimiser("adam", 0.6) == optimisers.Adam(0.6)
    with pytest.raises(InputError, match="choose one of adam"):
        optimisers.optimiser("lion")
