"""Training: the first frame (`keyframe`), every later frame (`later_frame`), and what both are made of."""

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
