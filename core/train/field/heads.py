"""Separate networks for opacity, colour and covariance (the paper's F_seps), inside the one network that travels.

Three small networks side by side are one network whose output weights are zero between the parts. So the variant needs
nothing of the bitstream or of a viewer; its three networks share out the hidden units instead of having more of them.
"""

from __future__ import annotations

import torch
from torch import Tensor

from streamlod.core.scene.anchors import HIDDEN

_UNITS = (8, 12, 12)  # hidden units of opacity, colour, and scale with rotation
_OUTPUTS = (1, 3, 7)  # outputs of each, for one Gaussian


def separate_heads(slots: int) -> Tensor:
    """[HIDDEN, 11K] bool: which hidden units feed which outputs of K = `slots` Gaussians."""
    assert sum(_UNITS) == HIDDEN
    head = torch.arange(3)
    unit = head.repeat_interleave(torch.tensor(_UNITS))
    output = head.repeat_interleave(slots * torch.tensor(_OUTPUTS))
    return unit[:, None] == output[None]
