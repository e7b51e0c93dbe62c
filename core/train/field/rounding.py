"""Rounding as it will be sent: training in the presence of quantisation, with straight-through gradients."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from streamlod.core.scene.anchors import SCALINGS
from streamlod.core.scene.quantise import DEFAULT_OFFSET
from streamlod.core.train.field.field import Field

FEATURE_STEP, OFFSET_STEP, SCALING_STEP = 0.025, 0.0125, 0.0125  # where nothing has been measured yet
USUAL = 2  # doublings of these that anchors take then


def round_through(values: Tensor) -> Tensor:
    """Nearest integers, with the gradient of the identity (straight-through; QUEEN, the paper's equation 9)."""
    return values + (values.round() - values).detach()


def dead_zone(values: Tensor) -> Tensor:
    """Integers of `values` (any shape, in steps): sign(v) floor(|v| + DEFAULT_OFFSET).

    Magnitudes below 1 - DEFAULT_OFFSET become zero, which costs little quality and saves many bits.
    """
    return values.abs().add_(DEFAULT_OFFSET).floor_().copysign_(values)


@dataclass(frozen=True, slots=True, eq=False)
class Precision:
    """How the numbers of a keyframe's anchors are rounded.

    Attributes:
        basis: [F,F] what is sent of features [N,F] is features @ `basis`; the network's first layer undoes it.
        inverse: [F,F] of `basis`.
        feature: [F], offset: [K,3], scaling: [6] widths of the finest step.
        shift: [N] doublings of these that each anchor takes.
    """

    basis: Tensor
    inverse: Tensor
    feature: Tensor
    offset: Tensor
    scaling: Tensor
    shift: Tensor

    def rounded(self, field: Field, rows: Tensor | None = None) -> Field:
        """`field`, which has the anchors `rows`, as the decoder will have it, with straight-through gradients."""
        times = 2.0 ** (self.shift if rows is None else self.shift[rows])[:, None]
        sent = _on_grid(field.feature.detach() @ self.basis, self.feature * times) @ self.inverse
        return replace(
            field,
            feature=field.feature + (sent - field.feature).detach(),
            offset=_on_grid(field.offset, self.offset * times[..., None]),
            scaling=_on_grid(field.scaling, self.scaling * times),
        )

    def sent(self, field: Field) -> Field:
        """`field` rounded, its features and its network in the coordinates that are sent."""
        times = 2.0 ** self.shift[:, None]
        weight, inputs = field.network.hidden_weight, len(self.basis)
        network = replace(field.network, hidden_weight=torch.cat([self.inverse @ weight[:inputs], weight[inputs:]]))
        return replace(
            field,
            feature=_on_grid(field.feature @ self.basis, self.feature * times),
            offset=_on_grid(field.offset, self.offset * times[..., None]),
            scaling=_on_grid(field.scaling, self.scaling * times),
            network=network,
        )


def usual_precision(field: Field, shift: int = USUAL) -> Precision:
    """Every anchor and every feature alike, `shift` doublings above the finest."""
    feature = field.feature
    basis = torch.eye(feature.shape[1], device=feature.device)
    return Precision(
        basis,
        basis,
        feature.new_full(feature.shape[1:], FEATURE_STEP),
        feature.new_full(field.offset.shape[1:], OFFSET_STEP),
        feature.new_full((SCALINGS,), SCALING_STEP),
        torch.full_like(field.level, shift),
    )


def _on_grid(values: Tensor, width: Tensor) -> Tensor:
    return round_through(values / width) * width
