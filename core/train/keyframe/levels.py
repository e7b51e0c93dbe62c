"""How many levels a scene needs: finest levels that hardly lower the loss are dropped."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

_IDLE_SHARE = 0.02  # a finest level carries nothing when the loss without it is at most this share higher,
_IDLE_LOSS = 1 / 255  # and one grey level


def needed_levels(levels: int, loss: Callable[[int], float]) -> int:
    """How many of the coarsest levels to keep, at least one.

    Coarse levels are kept whatever they carry: viewers on thin links have nothing else.

    Args:
        levels: how many there are.
        loss: of the pictures drawn with the levels up to one only, that included.
    """
    limit = (1 + _IDLE_SHARE) * loss(levels - 1) + _IDLE_LOSS
    while levels > 1 and loss(levels - 2) <= limit:
        levels -= 1
    return levels


class CoarseRows:
    """Anchors up to each level, looked up once for each set of anchors, since the host waits for a GPU to find them.

    Args:
        level: [N] of the anchors.
        levels: how many there are.
    """

    def __init__(self, level: Tensor, levels: int) -> None:
        self._rows = [torch.nonzero(level <= highest)[:, 0] for highest in range(levels - 1)]

    def up_to(self, highest: int) -> Tensor | None:
        """Rows of the anchors whose level is at most `highest`; None for all."""
        return self._rows[highest] if highest < len(self._rows) else None
