"""Anchors up to each level."""

from __future__ import annotations

import torch
from torch import Tensor


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
