"""A motion cue is a rule, found by its name: a toy one takes part in training without any other change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from streamlod.core.arrays import Bool
from streamlod.core.errors import InputError
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer, preset
from streamlod.core.train.motion import cues
from streamlod.core.train.motion.scores import Observation
from tests.core.true_points import true_points


def every_third(seen: Observation, posterior: float) -> Bool:
    """A toy: every third anchor is dynamic, whatever the pictures show."""
    assert posterior == preset("live").predict.posterior
    return np.asarray(seen.alive.numpy() & (np.arange(len(seen.field)) % 3 == 0))


def test_a_toy_cue_decides_what_is_trained(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(cues.CUES, "every third", cues.MotionCue(every_third, only_changed_views=False))
    spec = SyntheticSpec(cameras=3, frames=2, width=48, height=28, seed=1)
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


def test_an_unknown_cue_is_refused_and_the_known_are_named() -> None:
    with pytest.raises(InputError, match="difference, canonical"):
        cues.cue_of("flow")
