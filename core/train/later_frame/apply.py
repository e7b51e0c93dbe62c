"""Residuals applied to anchors with gradients: the decoder's result for the integers that would be sent now."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from streamlod.core.scene.anchors import FEATURE_LATENTS
from streamlod.core.train.field.field import Field
from streamlod.core.train.field.rounding import dead_zone


@dataclass(frozen=True, slots=True, eq=False)
class UnitChange:
    """What one step changes: feature [12,F] and offset [12,3K] by the latent decoders, position [n,1] of n anchors."""

    feature: Tensor
    offset: Tensor
    position: Tensor


def applied(field: Field, latent: Tensor, position: Tensor, unit: UnitChange) -> Field:
    """`field` of n anchors with residuals, rounded as they will be sent; gradients go straight through the rounding.

    Args:
        latent: [n,24], position: [n,3] real numbers, in steps.
    """
    parts = (latent, position, field.feature, field.offset, field.position, unit.feature, unit.offset, unit.position)
    feature, offset, moved = _Applied.apply(*parts)  # type: ignore[no-untyped-call]
    return replace(field, feature=feature, offset=offset, position=moved)


class _Applied(torch.autograd.Function):
    """A handful of passes over memory instead of autograd's thirty; on any device."""

    @staticmethod
    def forward(
        ctx: Any,
        latent: Tensor,
        position: Tensor,
        feature: Tensor,
        offset: Tensor,
        node: Tensor,
        feature_decoder: Tensor,
        offset_decoder: Tensor,
        steps: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        ctx.save_for_backward(feature_decoder, offset_decoder, steps)
        integers, moves = dead_zone(latent), dead_zone(position)
        return (
            torch.addmm(feature, integers[:, :FEATURE_LATENTS], feature_decoder),
            torch.addmm(offset.flatten(1), integers[:, FEATURE_LATENTS:], offset_decoder).view(offset.shape),
            torch.addcmul(node, moves, steps),
        )

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, feature: Tensor, offset: Tensor, position: Tensor) -> tuple[Tensor | None, ...]:
        feature_decoder, offset_decoder, steps = ctx.saved_tensors
        latent = torch.cat([feature @ feature_decoder.T, offset.flatten(1) @ offset_decoder.T], dim=1)
        return (latent, position * steps, *[None] * 6)
