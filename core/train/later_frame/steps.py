"""How many steps a later frame takes: more where more of the pictures changed than usual.

Where cameras and training keep one pace, at most a fifth of the pixels changes from frame to frame, and the configured
steps are enough. Where a frame trains for seconds, people stand elsewhere in the next one and are learnt anew.
"""

from __future__ import annotations

from torch import Tensor

from streamlod.core.train.config import PredictConfig

_USUAL = 0.2  # share of the pixels that may have changed for the configured steps to be enough


def steps_of(config: PredictConfig, masks: Tensor) -> int:
    """Steps of a frame that trains on the cameras of `masks` [C,H,W], bool: where their pictures changed.

    From a fifth of the pixels on they grow with the square of the share that changed, up to `config.most_effort` times
    those configured.
    """
    effort = (float(masks.float().mean()) / _USUAL) ** 2 if masks.numel() else 1.0
    return round(_configured(config, len(masks)) * max(min(effort, config.most_effort), 1.0))


def most_steps(config: PredictConfig, cameras: int) -> int:
    """Steps of a frame of which every pixel of all `cameras` changed."""
    return round(_configured(config, cameras) * max(config.most_effort, 1.0))


def _configured(config: PredictConfig, cameras: int) -> int:
    return max(config.epochs * cameras, config.minimum_steps)
