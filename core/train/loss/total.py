"""The loss of one picture, of first and later frames alike: what is seen, and what has a price."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from streamlod.core.render.tiles import Box
from streamlod.core.train.loss.photometric import photometric_loss


def total_loss(
    image: Tensor,
    target: Tensor,
    dssim_weight: float,
    prices: Sequence[Tensor] = (),
    region: Sequence[Box] | None = None,
    pixel_weights: Tensor | None = None,
) -> Tensor:
    """[] how far `image` [H,W,3] is from `target`, and the weighted `prices` [] of what made it (equation 10).

    Args:
        prices: of volume and opacity in a first frame, of bits in a later one.
        region, pixel_weights: as in `photometric_loss`.
    """
    loss = photometric_loss(image, target, dssim_weight, region, pixel_weights)
    for price in prices:
        loss = loss + price
    return loss
