"""How far a rendered picture is from the filmed one.

Loss of Kerbl et al. 2023, equation 7: (1 - w) L1 + w (1 - SSIM), SSIM with an 11x11 Gaussian window of sigma 1.5 and
zero padding, means over all pixels and channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from core.render.tiles import Box

WINDOW, SIGMA = 11, 1.5
_C1, _C2 = 0.01**2, 0.03**2


def photometric_loss(
    image: Tensor, target: Tensor, dssim_weight: float = 0.2, region: Sequence[Box] | None = None
) -> Tensor:
    """Scalar loss of `image` [H,W,3] float32 against `target` [H,W,3], both in [0, 1]; differentiable by `image`.

    On the CPU forward and backward are one numba pass; elsewhere they are `photometric_reference`.

    Args:
        dssim_weight: w above.
        region: evaluate only what the pixels of these boxes change. The gradient inside is that of the whole loss and
            zero outside; the value differs from the whole loss by what does not depend on the boxes' pixels. Boxes
            must lie ten pixels apart.

    Raises:
        ValueError: the shapes differ or are not [H,W,3], or a box is empty, leaves the picture or is near another.
    """
    if image.shape != target.shape or image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"pictures must both be [H,W,3], not {tuple(image.shape)} and {tuple(target.shape)}")
    height, width = image.shape[:2]
    boxes = (Box(0, 0, width, height),) if region is None else tuple(region)
    for box in boxes:
        if not (0 <= box.left < box.right <= width and 0 <= box.top < box.bottom <= height):
            raise ValueError(f"region {tuple(box)} does not lie inside a picture of {width}x{height}")
    for one, other in combinations(boxes, 2):
        if _gap(one, other) < WINDOW - 1:
            raise ValueError(f"regions {tuple(one)} and {tuple(other)} are less than {WINDOW - 1} pixels apart")
    if image.device.type == "cpu" and image.dtype == torch.float32:
        loss: Tensor = _Fused.apply(image, target, dssim_weight, boxes)  # type: ignore[no-untyped-call]
        return loss
    return photometric_reference(image, target, dssim_weight, region)


def photometric_reference(
    image: Tensor, target: Tensor, dssim_weight: float = 0.2, region: Sequence[Box] | None = None
) -> Tensor:
    """`photometric_loss` as torch convolutions, on any device and for any float type."""
    if region is not None:
        inside, near = (_pixels(image, region, room) for room in (0, WINDOW // 2))
        mixed = torch.where(inside, image, image.detach())
        difference, dissimilarity = (image - target).abs() * inside, (1 - ssim_map(mixed, target)) * near
    else:
        difference, dissimilarity = (image - target).abs(), 1 - ssim_map(image, target)
    return ((1 - dssim_weight) * difference.sum() + dssim_weight * dissimilarity.sum()) / image.numel()


def _pixels(image: Tensor, boxes: Sequence[Box], room: int) -> Tensor:
    """[H,W,1] bool: pixels of the boxes and `room` around them."""
    found = torch.zeros(*image.shape[:2], 1, dtype=torch.bool, device=image.device)
    for box in boxes:
        found[max(0, box.top - room) : box.bottom + room, max(0, box.left - room) : box.right + room] = True
    return found


def _gap(a: Box, b: Box) -> int:
    """Pixels between two boxes, along the axis that parts them more."""
    return max(a.left - b.right, b.left - a.right, a.top - b.bottom, b.top - a.bottom)


def ssim_map(image: Tensor, target: Tensor) -> Tensor:
    """[H,W,3] structural similarity of [H,W,3] pictures (Wang et al. 2004, equation 13)."""
    offsets = torch.arange(WINDOW, dtype=image.dtype, device=image.device) - WINDOW // 2
    line = torch.exp(-(offsets**2) / (2 * SIGMA**2))
    kernel = torch.outer(line, line) / line.sum() ** 2

    def blur(picture: Tensor) -> Tensor:
        planes = picture.permute(2, 0, 1)[:, None]
        return functional.conv2d(planes, kernel[None, None], padding=WINDOW // 2)[:, 0].permute(1, 2, 0)

    a, b = blur(image), blur(target)
    variances = blur(image * image) - a * a + blur(target * target) - b * b
    covariance = blur(image * target) - a * b
    return ((2 * a * b + _C1) * (2 * covariance + _C2)) / ((a * a + b * b + _C1) * (variances + _C2))


class _Fused(torch.autograd.Function):
    """The gradient is made together with the value, since it needs the same blurs."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, target: Tensor, dssim_weight: float, boxes: tuple[Box, ...]) -> Tensor:
        from core.render.cpu.photometric import photometric_sums

        value, gradient = photometric_sums(
            image.detach().contiguous().numpy(), target.detach().contiguous().numpy(), dssim_weight, boxes
        )
        ctx.gradient = torch.from_numpy(gradient)
        return image.new_tensor(value)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        if upstream != 1:  # no backward pass may change what another may ask for again
            return ctx.gradient * upstream, None, None, None
        return ctx.gradient, None, None, None
