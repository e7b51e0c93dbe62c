"""The preset `paper`: what the paper takes for every setting of `core.train.config`, and where each comes from.

Nothing is taken from our defaults, so that tuning ours never moves the baseline. docs/preset-paper.md shows them,
printed by `tests.paper_page`.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from streamlod.core.train.config import KeyframeConfig, ModelConfig, PartSettings, PredictConfig, TrainConfig
from streamlod.core.train.paper.growth import PaperGrowth

_PARTS = {"model": ModelConfig, "keyframe": KeyframeConfig, "predict": PredictConfig}
OF_LATER_FRAMES: tuple[PartSettings, ...] = (PaperGrowth(),)  # instead of ours


def paper() -> TrainConfig:
    """The configuration of the paper."""
    return TrainConfig(**{name: part(**_values(part)) for name, part in _PARTS.items()}, parts=OF_LATER_FRAMES, seed=0)


def _values(part: type[ModelConfig | KeyframeConfig | PredictConfig]) -> dict[str, Any]:
    return {field.name: field.metadata["paper"].value for field in fields(part)}
