"""A motion cue is one object, found by its name: a toy one takes part in training without any other change."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from streamlod.core.arrays import Bool
from streamlod.core.errors import InputError
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import PredictConfig, Trainer, preset
from streamlod.core.train.motion import cues
from streamlod.core.train.motion.partition import Observation
from tests.core.true_points import true_points


@dataclass(frozen=True)
class EveryNth:
    """A toy: every `stride`-th anchor is dynamic, whatever the pictures show."""

    stride: int

    @property
    def only_changed_views(self) -> bool:
        return False

    def partition(self, seen: Observation) -> Bool:
        chosen = seen.alive.numpy() & (np.arange(len(seen.field)) % self.stride == 0)
        return np.asarray(chosen)


def test_a_toy_cue_decides_what_is_trained(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(cues.CUES, "every third", lambda config: EveryNth(3))
    spec = SyntheticSpec(cameras=3, frames=2, width=96, height=56, seed=1)
    clip = open_synthetic(spec)
    first, second = clip.frames()
    config = preset("live")
    config = replace(
        config,
        keyframe=replace(config.keyframe, steps=20),
        predict=replace(config.predict, cue="every third", epochs=1, minimum_steps=4),
    )
    trainer = Trainer(clip.cameras, config, clip.fps, "cpu")
    anchors = trainer.keyframe(first, true_points(spec)).scene.anchor_count
    trained = trainer.predict(second)
    assert trained.report.steps == 4
    assert trained.dynamic is not None
    assert np.flatnonzero(trained.dynamic).tolist() == list(range(0, anchors, 3))
    assert trained.residual is not None
    assert trained.residual.changed > 0


@pytest.mark.parametrize("name", sorted(cues.CUES))
def test_cues_take_their_settings_from_the_configuration(name: str) -> None:
    config = PredictConfig(cue=name, posterior=0.7)
    cue = cues.cue_of(config)
    assert isinstance(cue, cues.Difference | cues.RenderingError)
    assert cue.posterior == 0.7
    assert cue.only_changed_views == (name == "difference")


def test_an_unknown_cue_is_refused_and_the_known_are_named() -> None:
    with pytest.raises(InputError, match="difference, canonical"):
        cues.cue_of(PredictConfig(cue="flow"))
