"""Pixels that a camera clipped to white or black: they do not say how bright or dark it was."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

CLIPPED = 1.5 / 255  # nearer to black or full brightness, a pixel does not say how dark or bright it was


def clipped_sides(pictures: Tensor) -> Tensor:
    """[...] int8, of values in [0, 1] of the same shape: 1 where one is clipped to white, -1 to black, 0 elsewhere."""
    white, black = pictures > 1 - CLIPPED, pictures < CLIPPED
    return white.to(torch.int8) - black.to(torch.int8)


def limited(image: Tensor, target: Tensor, sides: Tensor) -> Tensor:
    """`image`, but `target` without a gradient where `sides` says that it is clipped, and `image` is beyond it.

    Args:
        image, target: [H,W,3] what is shown and what was filmed.
        sides: [H,W,3] `clipped_sides` of `target`.
    """
    shown: Tensor = _Limited.apply(image, target, sides)  # type: ignore[no-untyped-call]
    return shown


class _Limited(torch.autograd.Function):
    """Written to launch few kernels."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, target: Tensor, sides: Tensor) -> Tensor:
        within = (image - target).mul_(sides) <= 0
        ctx.save_for_backward(within)
        return torch.where(within, image, target)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        (within,) = ctx.saved_tensors
        return upstream * within, None, None
