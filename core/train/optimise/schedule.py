"""Schedules of a run: learning rates, dropout, unlocked levels, the order of views."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from streamlod.core.train.config import KeyframeConfig

_UNLOCK_RATIO = 1 / 1.5  # each level unlocks after 1/1.5 of the interval before it (docs/method.md, reading 9)


def keyframe_rates(config: KeyframeConfig, progress: float) -> dict[str, float]:
    """Rates at `progress` in [0, 1] of the first frame's run."""
    decay = config.final_rate**progress
    return {
        "feature": config.feature_rate * decay**0.5,
        "offset": config.offset_rate * decay,
        "scaling": config.scaling_rate * decay**0.5,
        "network": config.network_rate * decay,
        "exposure": 0.002 * decay,
    }


def dropout_keep(
    level: Tensor,
    levels: int,
    config: KeyframeConfig,
    progress: float,
    generator: torch.Generator,
    share: Tensor,
) -> Tensor:
    """[G] factors of the opacities: 0 for dropped Gaussians, 1 / (1 - r) for the others.

    r = (base + slope * level) * progress, capped (paper section IV-A; compensation as in DropGaussian).

    Args:
        level: [G] level of each Gaussian's anchor, below `levels`.
        share: [G] of that rate.
    """
    rates = config.dropout_base + config.dropout_slope * torch.arange(levels).float()
    rates = (rates * progress).clamp(max=config.dropout_cap)
    rate = rates.to(level.device, non_blocking=True)[level] * share
    kept = torch.rand(len(level), generator=generator, device=level.device) >= rate
    return kept / (1 - rate)


def unlocked_level(levels: int, config: KeyframeConfig, progress: float) -> int:
    """Finest level in use at `progress`, from the middle one upwards (docs/method.md, reading 9)."""
    first = levels // 2
    steps = levels - 1 - first
    if steps <= 0 or config.progressive_until <= 0:
        return levels - 1
    first_interval = config.progressive_until * (1 - _UNLOCK_RATIO) / (1 - _UNLOCK_RATIO**steps)
    times = np.cumsum(first_interval * _UNLOCK_RATIO ** np.arange(steps))
    return first + int(np.searchsorted(times, progress, side="right"))


def view_order(views: list[int], generator: torch.Generator) -> Iterator[int]:
    """Endless random epochs over the cameras `views`: every one once before any comes again."""
    while True:
        yield from (views[i] for i in reversed(torch.randperm(len(views), generator=generator).tolist()))
