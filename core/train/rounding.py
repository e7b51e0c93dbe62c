"""Rounding as it will be sent: training in the presence of quantisation, with straight-through gradients."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from core.quantise import DEFAULT_OFFSET

FEATURE_STEP, OFFSET_STEP, SCALING_STEP = 0.025, 0.0125, 0.0125  # the finest; most anchors take multiples


def round_through(values: Tensor) -> Tensor:
    """Nearest integers, with the gradient of the identity (straight-through; QUEEN, the paper's equation 9)."""
    return values + (values.round() - values).detach()


def dead_zone(values: Tensor) -> Tensor:
    """Integers of `values`, as `core.quantise.dead_zone` makes them."""
    return (values.abs() + DEFAULT_OFFSET).floor() * values.sign()


def dead_zone_through(values: Tensor) -> Tensor:
    """`dead_zone` with the gradient of the identity: what training sees of residuals is what is sent."""
    return values + (dead_zone(values) - values).detach()


@dataclass(frozen=True, slots=True)
class Steps:
    """Widths of the finest quantum: of features, offsets (in multiples of the anchor's size) and log-scales."""

    feature: float = FEATURE_STEP
    offset: float = OFFSET_STEP
    scaling: float = SCALING_STEP

    def rounded(self, feature: Tensor, offset: Tensor, scaling: Tensor, shift: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The three arrays on their grids, each row's 2^`shift` [N] quanta wide, with straight-through gradients."""
        times = (2.0**shift)[:, None]
        return (
            _on_grid(feature, self.feature * times),
            _on_grid(offset, self.offset * times[..., None]),
            _on_grid(scaling, self.scaling * times),
        )


def _on_grid(values: Tensor, width: Tensor) -> Tensor:
    return round_through(values / width) * width


def to_int16(values: Tensor, step: float) -> Tensor:
    """Quanta of `values`, saturated to int16."""
    limits = torch.iinfo(torch.int16)
    return (values / step).round().clamp(limits.min, limits.max).to(torch.int16)
