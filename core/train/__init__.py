"""Training: the first frame (`keyframe`), every later frame (`residual`), and what both are made of."""

from core.train.config import KeyframeConfig, ModelConfig, PredictConfig, TrainConfig
from core.train.presets.named import PRESETS, preset
from core.train.progress import FrameReport, Progress, TrainedFrame
from core.train.trainer import Trainer

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
