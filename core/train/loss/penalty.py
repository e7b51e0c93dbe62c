"""The price of Gaussians whatever they show: volume (Octree-GS; docs/method.md, reading 20) and opacity in view."""

from __future__ import annotations

import torch
from torch import Tensor

from streamlod.core.train.loss.known_gradient import with_gradient


def penalty(
    scales: Tensor,
    opacities: Tensor,
    visible: Tensor,
    scale_weight: float,
    opacity_weight: float,
    share: Tensor,
    hiding: Tensor,
) -> Tensor:
    """[] weighted sum of the mean volume of the Gaussians that are drawn and of the opacity of those in view, over G.

    Args:
        scales: [G,3]. opacities: [G], at or below zero for those that are not drawn.
        visible: [V] int64 rows of the Gaussians in view of the picture that is trained.
        share: [G] of the price on opacity that each pays.
        hiding: [G] further price of each opacity, in view or not.
    """
    price_in_view = opacity_weight / max(len(opacities), 1)
    prices = torch.zeros_like(opacities, requires_grad=False).index_fill_(0, visible, price_in_view) * share + hiding
    if scales.device.type == "cpu":
        return penalty_reference(scales, opacities, prices, scale_weight)
    price, *gradients = _priced(scales, opacities, prices, (opacities > 0).sum(), scale_weight)
    return with_gradient(price.sum(), [scales, opacities], gradients)


def penalty_reference(scales: Tensor, opacities: Tensor, prices: Tensor, scale_weight: float) -> Tensor:
    """`penalty` differentiated by torch, on any device; prices: [G] what each opacity costs."""
    opacity = opacities.clamp(min=0)
    drawn = (opacity.detach() > 0).float()
    volume = (scales.prod(dim=1) * drawn).sum() / drawn.sum().clamp_min(1)
    return scale_weight * volume + (opacity * prices).sum()


@torch.no_grad()
def _priced(
    scales: Tensor, opacities: Tensor, prices: Tensor, drawn: Tensor, scale_weight: float
) -> tuple[Tensor, Tensor, Tensor]:
    """[G] what each Gaussian adds, and the derivatives by `scales` [G,3] and `opacities` [G].

    Args:
        drawn: [] how many Gaussians are drawn.
    """
    x, y, z = scales.unbind(dim=1)
    volume_weight = scale_weight * (opacities > 0) / drawn.clamp_min(1)
    price = volume_weight * x * y * z + prices * opacities.clamp(min=0)
    by_scales = volume_weight[:, None] * torch.stack([y * z, x * z, x * y], dim=1)
    return price, by_scales, prices * (opacities >= 0)
