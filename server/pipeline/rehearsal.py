"""Trains a few tiny frames, which loads and compiles all the code that real ones need."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamlod.core.frames import PointCloud
from streamlod.core.scene.keyframe import as_keyframe
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer, preset

_CLIP = SyntheticSpec(cameras=2, frames=3, width=48, height=32)
_POINTS = 200


def rehearse(preset_name: str, device: str) -> None:
    """Train a first frame, a later one, and one more after a restart, in a dozen steps; about a second.

    Args:
        preset_name, device: as in `TrainJob`.

    Raises:
        InputError: no such preset.
        BackendUnavailable: no such device.
    """
    clip, config = open_synthetic(_CLIP), preset(preset_name)
    brief = replace(
        config,
        keyframe=replace(config.keyframe, steps=12, growth_interval=4),
        predict=replace(config.predict, epochs=1, minimum_steps=2),
    )
    draw = np.random.default_rng(0)
    points = PointCloud(*(draw.uniform(low, 1, (_POINTS, 3)).astype(np.float32) for low in (-1, 0)))
    first, later, last = clip.frames()
    trainer = Trainer(clip.cameras, brief, clip.fps, device)
    trainer.keyframe(first, points)
    trained = trainer.predict(later)
    trainer = Trainer(clip.cameras, brief, clip.fps, device)
    trainer.resume(as_keyframe(trained.scene, last.index))
    trainer.predict(replace(last, index=last.index + 1))
