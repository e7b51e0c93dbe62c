"""Training: the first frame (`keyframe`), every later frame (`later_frame`), and what both are made of.

The names below are loaded when they are first used: settings of the method are checked without the training library.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from streamlod.core.train.config import KeyframeConfig, ModelConfig, PredictConfig, TrainConfig
    from streamlod.core.train.presets.named import PRESETS, preset
    from streamlod.core.train.progress import FrameReport, Progress, TrainedFrame
    from streamlod.core.train.trainer import Trainer

__all__ = [
    "PRESETS",
    "FrameReport",
    "KeyframeConfig",
    "ModelConfig",
    "PredictConfig",
    "Progress",
    "TrainConfig",
    "TrainedFrame",
    "Trainer",
    "preset",
]

_HOMES = {
    "config": ("KeyframeConfig", "ModelConfig", "PredictConfig", "TrainConfig"),
    "presets.named": ("PRESETS", "preset"),
    "progress": ("FrameReport", "Progress", "TrainedFrame"),
    "trainer": ("Trainer",),
}
_HOME_OF = {name: f"{__name__}.{module}" for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME_OF[name]), name)
