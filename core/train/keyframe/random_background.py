"""Pictures of a first frame over a random colour, so that surfaces must become opaque to hide it.

Over black alone, a surface may stay half transparent wherever black makes its colour; to other views it shows what is
behind it. Where a picture is black, the background stays black: nothing need be there, as around a lit stage.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

_BLACK = 1 / 16  # the brightest channel of a pixel that may show nothing at all


def over_colour(image: Tensor, transmittance: Tensor, target: Tensor, colour: Tensor) -> Tensor:
    """Put `image` [H,W,3] over `colour` [3], except where `target` [H,W,3] is black; transmittance is [H,W]."""
    shown: Tensor = _OverColour.apply(image, transmittance, target, colour)  # type: ignore[no-untyped-call]
    return shown


def _lit(target: Tensor) -> Tensor:
    """[H,W] bool: pixels that are not black."""
    red, green, blue = target.unbind(dim=2)
    return torch.maximum(torch.maximum(red, green), blue) > _BLACK


class _OverColour(torch.autograd.Function):
    """The gradient is written down, in few launches."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, transmittance: Tensor, target: Tensor, colour: Tensor) -> Tensor:
        ctx.save_for_backward(target, colour)
        return image + (transmittance * _lit(target))[..., None] * colour

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        target, colour = ctx.saved_tensors
        red, green, blue = (upstream * colour).unbind(dim=2)
        return upstream, (red + green + blue) * _lit(target), None, None
