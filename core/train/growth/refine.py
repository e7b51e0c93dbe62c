"""Growing and pruning between the training steps of the first frame (paper section IV-A)."""

from __future__ import annotations

import torch
from torch import Tensor

from streamlod.core.train.config import KeyframeConfig
from streamlod.core.train.field.learned import LearnedField
from streamlod.core.train.growth.gradient import GrowthStatistics, earned_extra_level, grow
from streamlod.core.train.growth.new_anchors import first_values


def refine(
    learned: LearnedField,
    statistics: GrowthStatistics,
    config: KeyframeConfig,
    highest: int,
    most_anchors: int,
    generator: torch.Generator,
    astray: Tensor | None,
) -> None:
    """Add anchors to `learned` where gradients are large, remove what is nearly transparent.

    Args:
        statistics: of the steps since the last time.
        highest: finest level that may receive anchors.
        most_anchors: that there may be.
        astray: [N] anchors to be removed whatever their opacity; None for none.
    """
    field = learned.settled
    gradient, threshold = statistics.mean_gradient(), config.growth_threshold
    extra = earned_extra_level(field, gradient, threshold).float() * config.extra_level_gain
    new = grow(field, gradient, threshold, highest, max(most_anchors - len(field), 0))
    removed = statistics.faint(config.prune_opacity)
    kept = torch.nonzero(~(removed if astray is None else removed | astray))[:, 0]
    if len(kept) + len(new) == 0:  # nothing would ever grow again
        return
    learned.keep(kept, first_values(field, new, generator), extra)
