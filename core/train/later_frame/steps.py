"""How many steps a later frame takes: more where more of the pictures changed than usual.

At a camera's pace up to a fifth of the pictures changes from one to the next, and the configured steps are enough.
Where training takes seconds a frame, people stand elsewhere in the next one, and all of them has to be learnt anew.
"""

from __future__ import annotations

from torch import Tensor

from streamlod.core.train.config import PredictConfig

_USUAL = 0.2  # share of the pixels that may have changed for the configured steps to be enough


def steps_of(config: PredictConfig, masks: Tensor) -> int:
    """Steps of a frame that trains on the cameras of `masks` [C,H,W], bool: where their pictures changed.

    They grow with the square of the share of the pixels that changed, from a fifth on, up to `config.most_effort` times
    the usual ones.
    """
    usual = max(config.epochs * len(masks), config.minimum_steps)
    effort = (float(masks.float().mean()) / _USUAL) ** 2 if masks.numel() else 1.0
    return round(usual * min(max(effort, 1.0), config.most_effort))
