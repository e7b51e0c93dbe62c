"""The run of a keyframe in mid-stream: everything of a state is trained on, against the picture of its instant.

Later frames change features and offsets along fixed directions, where pictures change; sizes of Gaussians and the
network stay, and what is not worth its bytes is left undone. All that adds up to a decibel and more in fifty frames. A
keyframe carries everything anyway, so it can catch up; going on from the state takes a fraction of a first frame's run.
"""

from __future__ import annotations

from dataclasses import replace

from core.train.config import TrainConfig
from core.train.field.field import Field

_ADJUSTMENTS = 8  # times that anchors may grow and go, in one run


def renewal_config(config: TrainConfig, field: Field, version: int) -> TrainConfig:
    """What a first frame's run becomes for `field`, the living anchors of a state at `version`.

    As long as configured, at full size and with all levels from the start. Levels stay, and as many anchors may come as
    go: with every run a few more would always find something to fit.
    """
    steps = config.keyframe.renewal_steps
    keyframe = replace(
        config.keyframe,
        steps=steps,
        least_gain=0.0,
        half_size_until=0.0,
        progressive_until=0.0,
        growth_interval=max(1, steps // _ADJUSTMENTS),
    )
    return replace(
        config,
        model=replace(config.model, levels=field.octree.levels, max_anchors=len(field)),
        keyframe=keyframe,
        seed=config.seed + version,
    )
