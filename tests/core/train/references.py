"""What the trainer's kernels compute, said plainly and differentiated by torch, for any device and float type."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional

from streamlod.core.render.tiles import Box
from streamlod.core.scene.anchors import FEATURE_LATENTS
from streamlod.core.scene.entropy_model import BINS, UNIT_BIN, magnitude_bits
from streamlod.core.scene.gaussians import MAX_LOG_SCALE
from streamlod.core.scene.quantise import DEFAULT_OFFSET
from streamlod.core.train.field.field import Field
from streamlod.core.train.field.rounding import dead_zone
from streamlod.core.train.later_frame.apply import UnitChange
from streamlod.core.train.loss.photometric import SIGMA, WINDOW
from streamlod.core.train.optimise.rate import SET_BITS

_HIGHEST = 64  # magnitude in the table of bits
_TYPICAL = 0.5  # weight of the average anchor beside the anchor's own other values


def photometric_reference(
    image: Tensor,
    target: Tensor,
    dssim_weight: float = 0.2,
    region: Sequence[Box] | None = None,
    pixel_weights: Tensor | None = None,
) -> Tensor:
    """`core.train.loss.photometric.photometric_loss` as torch convolutions."""
    if region is not None:
        inside, near = (_pixels(image, region, room) for room in (0, WINDOW // 2))
        mixed = torch.where(inside, image, image.detach())
        difference, dissimilarity = (image - target).abs() * inside, (1 - ssim_reference(mixed, target)) * near
    else:
        difference, dissimilarity = (image - target).abs(), 1 - ssim_reference(image, target)
    difference = difference if pixel_weights is None else pixel_weights * difference
    return ((1 - dssim_weight) * difference.sum() + dssim_weight * dissimilarity.sum()) / image.numel()


def _pixels(image: Tensor, boxes: Sequence[Box], room: int) -> Tensor:
    """[H,W,1] bool: pixels of the boxes and `room` around them."""
    found = torch.zeros(*image.shape[:2], 1, dtype=torch.bool, device=image.device)
    for box in boxes:
        found[max(0, box.top - room) : box.bottom + room, max(0, box.left - room) : box.right + room] = True
    return found


def ssim_reference(image: Tensor, target: Tensor) -> Tensor:
    """[H,W,3] structural similarity of [H,W,3] pictures (Wang et al. 2004, equation 13)."""
    away = torch.arange(WINDOW).to(image) - WINDOW // 2
    line = torch.exp(-(away**2) / (2 * SIGMA**2))
    kernel = torch.outer(line, line) / line.sum() ** 2

    def blur(picture: Tensor) -> Tensor:
        planes = picture.permute(2, 0, 1)[:, None]
        return functional.conv2d(planes, kernel[None, None], padding=WINDOW // 2)[:, 0].permute(1, 2, 0)

    a, b = blur(image), blur(target)
    variances = blur(image * image) - a * a + blur(target * target) - b * b
    covariance = blur(image * target) - a * b
    first, second = 0.01**2, 0.03**2
    return ((2 * a * b + first) * (2 * covariance + second)) / ((a * a + b * b + first) * (variances + second))


def decode_reference(
    inputs: Tensor,
    offset: Tensor,
    scaling: Tensor,
    position: Tensor,
    hidden_weight: Tensor,
    hidden_bias: Tensor,
    output_weight: Tensor,
    output_bias: Tensor,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """The parts of the `Splats` that `core.train.field.decode.decode` makes."""
    count, slots = offset.shape[:2]
    outputs = (inputs @ hidden_weight + hidden_bias).relu() @ output_weight + output_bias
    opacity, colour, relative, rotation = torch.split(outputs, [slots, 3 * slots, 3 * slots, 4 * slots], dim=1)
    size = scaling.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE).exp()
    return (
        (position[:, None] + offset * size[:, None, :3]).reshape(-1, 3),
        rotation.reshape(-1, 4) + torch.tensor([1.0, 0.0, 0.0, 0.0]).to(outputs),
        (size[:, None, 3:] * relative.reshape(count, slots, 3).sigmoid()).reshape(-1, 3),
        opacity.tanh().reshape(-1),
        colour.sigmoid().reshape(-1, 3),
    )


def applied_reference(field: Field, latent: Tensor, position: Tensor, unit: UnitChange) -> Field:
    """`core.train.later_frame.apply.applied`."""
    latent, position = dead_zone_through(latent), dead_zone_through(position)
    offset = latent[:, FEATURE_LATENTS:] @ unit.offset
    return replace(
        field,
        feature=field.feature + latent[:, :FEATURE_LATENTS] @ unit.feature,
        offset=field.offset + offset.reshape(field.offset.shape),
        position=field.position + position * unit.position,
    )


def dead_zone_through(values: Tensor) -> Tensor:
    """`dead_zone` with the gradient of the identity."""
    return values + (dead_zone(values) - values).detach()


def residual_bits_reference(latent: Tensor, position: Tensor) -> Tensor:
    """`core.train.optimise.rate.residual_bits`."""
    largest = torch.cat([latent, position], dim=1).abs().amax(dim=1)
    return _coded_bits(latent) + _coded_bits(position) + SET_BITS * largest.clamp(max=1).sum()


def _coded_bits(values: Tensor) -> Tensor:
    """[] bits of values [n,C] coded row by row."""
    size, channels = values.abs().clamp(max=_HIGHEST - 0.01), values.shape[1]
    table = torch.from_numpy(magnitude_bits(_HIGHEST)).to(values.device)
    lower, rounded = size.detach().floor().long().clamp(0, _HIGHEST - 1), (size.detach() + DEFAULT_OFFSET).floor()
    rows = rounded.sum(dim=1, keepdim=True)
    expected = (_TYPICAL * rows.mean() + rows - rounded) / (_TYPICAL * channels + channels - 1)
    bins = (UNIT_BIN + 4 * expected.clamp_min(1e-3).log2()).round().long().clamp(0, BINS - 1)
    cost, next_cost = table[bins, lower], table[bins, lower + 1]
    return (cost + (size - lower) * (next_cost - cost)).sum()


def update_reference(
    value: Tensor,
    gradient: Tensor,
    first: Tensor,
    second: Tensor,
    rate: float,
    correction2: float,
    memory: float = 0.9,
) -> Tensor:
    """`core.train.optimise.adam.update` of one value; returns how many entries of the gradient were broken."""
    broken = gradient.numel() - torch.isfinite(gradient).sum()
    gradient = gradient.nan_to_num(0.0, 0.0, 0.0)
    first.lerp_(gradient, 1 - memory)
    second.mul_(0.999).addcmul_(gradient, gradient, value=1 - 0.999)
    value.addcdiv_(first, (second / correction2).sqrt_().add_(1e-15), value=-rate)
    return broken
