"""Named configurations: our three, and the paper's."""

from __future__ import annotations

from streamlod.core.errors import unknown_name
from streamlod.core.train.config import KeyframeConfig, ModelConfig, PredictConfig, TrainConfig
from streamlod.core.train.later_frame.parts import USUAL
from streamlod.core.train.paper.preset import paper

PRESETS = {
    "live": TrainConfig(
        keyframe=KeyframeConfig(steps=1280), predict=PredictConfig(epochs=8, minimum_steps=56), parts=USUAL
    ),
    "balanced": TrainConfig(parts=USUAL),
    "quality": TrainConfig(
        ModelConfig(max_anchors=200_000),
        KeyframeConfig(refresh_steps=400),
        PredictConfig(epochs=40, minimum_steps=320, rate_weight=0.0042),
        USUAL,
    ),
    "paper": paper(),
}


def preset(name: str) -> TrainConfig:
    """A named configuration.

    Raises:
        InputError: no such preset.
    """
    if name not in PRESETS:
        raise unknown_name("preset", name, PRESETS)
    return PRESETS[name]
