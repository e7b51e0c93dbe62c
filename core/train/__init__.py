"""Training: the first frame (`keyframe`), every later frame (`online`), and what both stand on."""

from core.train.config import KeyframeConfig, ModelConfig, PredictConfig, TrainConfig, preset
from core.train.progress import FrameReport, Progress, TrainedFrame
from core.train.trainer import Trainer

__all__ = [
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
