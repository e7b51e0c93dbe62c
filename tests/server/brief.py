"""Training cut short, for tests of what flows rather than of quality."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from streamlod.core.train import TrainConfig, preset


@contextmanager
def brief_training(steps: int = 30) -> Iterator[None]:
    """A first frame of so many steps, later ones of 8 or a few more."""

    def brief(name: str) -> TrainConfig:
        config = preset(name)
        return replace(
            config,
            keyframe=replace(config.keyframe, steps=steps, growth_interval=steps // 3, refresh_steps=10),
            predict=replace(config.predict, epochs=2, minimum_steps=8),
        )

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("streamlod.server.pipeline.stages.training.preset", brief)
        yield
