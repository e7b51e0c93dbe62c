"""The run of a refresh keyframe: everything in a state is trained further, against the pictures of its instant.

Later frames change features and offsets along fixed directions, where pictures change; sizes of Gaussians and the
network stay, and changes that are not worth their bytes are never sent. In fifty frames this costs a decibel or more.
A keyframe carries everything anyway, so all of it can be trained; as training goes on from the state, that takes a
fraction of a first frame's run.
"""

from __future__ import annotations

from dataclasses import replace

from streamlod.core.train.config import TrainConfig
from streamlod.core.train.field.field import Field

_REFINEMENTS = 8  # of one run, in which anchors are added and removed


def refresh_config(config: TrainConfig, field: Field, version: int, first_count: int) -> TrainConfig:
    """The settings of a first frame's run, changed for `field`, the living anchors of a state at `version`.

    As many steps as configured, at full size and with all levels from the start. The number of levels stays. Anchors
    that have faded go; those without effect stay, for what hides them now moves on. Others grow up to the number that
    the first frame had, `first_count`, or to the present one: later frames add few, and in hundreds of frames a stream
    would fade.
    """
    steps = config.keyframe.refresh_steps
    most = min(max(first_count, len(field)), config.model.max_anchors)
    keyframe = replace(
        config.keyframe,
        steps=steps,
        half_size_until=0.0,
        progressive_until=0.0,
        effect_share=0.0,
        growth_interval=max(1, steps // _REFINEMENTS),
    )
    return replace(
        config,
        model=replace(config.model, levels=field.octree.levels, max_anchors=most),
        keyframe=keyframe,
        seed=config.seed + version,
    )
