"""What a frame's residual will cost, as a term of the loss: the codec's own tables, so that training pays what is sent.

A value is coded under a bin of its expected magnitude. Here, as in the codec, that expectation comes from the other
values of the anchor and from the average anchor; it is a constant to the gradient. Between integers the cost is
interpolated linearly.
"""

from __future__ import annotations

import functools
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

from core.scene.entropy_model import BINS, UNIT_BIN, magnitude_bits
from core.scene.quantise import DEFAULT_OFFSET
from core.train.kernels import rate as kernels

SET_BITS = 4.0  # about what it costs that an anchor changes at all: its place in the dynamic set
_TYPICAL = 0.5  # weight of the average anchor beside the anchor's own other values
_HIGHEST, _BELOW = 64, 0.01  # magnitudes count as at most so much below the highest of the table


def residual_bits(latent: Tensor, position: Tensor) -> Tensor:
    """[] bits of the residuals of n anchors; value and gradient are made together, on the CPU in one numba pass.

    Args:
        latent: [n,24], position: [n,3] real numbers in steps, before they are rounded.
    """
    on_cpu = all(values.device.type == "cpu" and values.dtype == torch.float32 for values in (latent, position))
    bits: Tensor = (_Fused if on_cpu else _OnDevice).apply(latent, position)  # type: ignore[no-untyped-call]
    return bits


def residual_bits_reference(latent: Tensor, position: Tensor) -> Tensor:
    """`residual_bits` differentiated by torch, on any device and for any float type."""
    largest = torch.cat([latent, position], dim=1).abs().amax(dim=1)
    return _coded_bits(latent) + _coded_bits(position) + SET_BITS * largest.clamp(max=1).sum()


class _Fused(torch.autograd.Function):
    """The gradient is made together with the value, since it needs the same bins."""

    @staticmethod
    def forward(ctx: Any, latent: Tensor, position: Tensor) -> Tensor:
        values = [tensor.detach().contiguous().numpy() for tensor in (latent, position)]
        gradients = [np.empty(array.shape, np.float32) for array in values]
        sums = np.zeros((max(1, min(numba.get_num_threads(), len(latent))), 3))
        table, price = _table(latent.device).numpy(), np.float32(SET_BITS)
        bits = kernels.residual_bits(sums, *values, table, _TYPICAL, price, *gradients)
        ctx.gradients = [torch.from_numpy(gradient) for gradient in gradients]
        return latent.new_tensor(bits)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, ...]:
        return tuple(gradient * upstream for gradient in ctx.gradients)


class _OnDevice(torch.autograd.Function):
    """`residual_bits_reference` in few launches: the gradient is written down."""

    @staticmethod
    def forward(ctx: Any, latent: Tensor, position: Tensor) -> Tensor:
        of_latent, of_position = _row_sums(latent, position)
        means = of_latent.mean(), of_position.mean()
        bits, *ctx.gradients = _priced(latent, position, of_latent, of_position, *means, _table(latent.device))
        total: Tensor = bits.sum()
        return total

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, ...]:
        return tuple(torch._foreach_mul(ctx.gradients, upstream))


def _row_sums(latent: Tensor, position: Tensor) -> tuple[Tensor, Tensor]:
    """[n] sums of what the magnitudes of each row round to, of latents and of positions."""
    found = [_rounded(_magnitude(values)).sum(dim=1) for values in (latent, position)]
    return found[0], found[1]


def _priced(
    latent: Tensor,
    position: Tensor,
    latent_rows: Tensor,
    position_rows: Tensor,
    latent_mean: Tensor,
    position_mean: Tensor,
    table: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """[n] bits of each anchor, and their derivatives by `latent` [n,24] and `position` [n,3].

    Args:
        latent_rows, position_rows: [n] as `_row_sums` gives them; latent_mean, position_mean: [] their means.
    """
    of_latents, by_latents = _prices(latent, latent_rows, latent_mean, table)
    of_positions, by_positions = _prices(position, position_rows, position_mean, table)
    largest = torch.maximum(latent.abs().amax(dim=1), position.abs().amax(dim=1))[:, None]
    first, second = latent.abs() == largest, position.abs() == largest
    # shared among the largest, as torch shares the gradient of a maximum
    slope = SET_BITS * (largest <= 1) / (first.sum(dim=1) + second.sum(dim=1))[:, None]
    return (
        of_latents + of_positions + SET_BITS * largest[:, 0].clamp(max=1),
        by_latents + first * slope * latent.sign(),
        by_positions + second * slope * position.sign(),
    )


def _prices(values: Tensor, rows: Tensor, mean: Tensor, table: Tensor) -> tuple[Tensor, Tensor]:
    """[n] bits of values [n,C] coded row by row, and their derivatives [n,C]."""
    size = _magnitude(values)
    lower = size.floor().long().clamp(0, _HIGHEST - 1)  # in the table, whatever becomes of NaN
    bins = _bins(rows[:, None] - _rounded(size), mean, values.shape[1])
    cost = table[bins, lower]
    steeper = table[bins, lower + 1] - cost
    held = values.abs() <= _HIGHEST - _BELOW
    return (cost + (size - lower) * steeper).sum(dim=1), steeper * values.sign() * held


def _coded_bits(values: Tensor) -> Tensor:
    """[] bits of values [n,C] coded row by row."""
    size = _magnitude(values)
    lower = size.detach().floor().long().clamp(0, _HIGHEST - 1)
    table, rounded = _table(values.device), _rounded(size.detach())
    rows = rounded.sum(dim=1, keepdim=True)
    bins = _bins(rows - rounded, rows.mean(), values.shape[1])
    cost, next_cost = table[bins, lower], table[bins, lower + 1]
    return (cost + (size - lower) * (next_cost - cost)).sum()


def _magnitude(values: Tensor) -> Tensor:
    return values.abs().clamp(max=_HIGHEST - _BELOW)


def _rounded(size: Tensor) -> Tensor:
    """What magnitudes are quantised to."""
    return (size + DEFAULT_OFFSET).floor()


def _bins(rest: Tensor, mean: Tensor, channels: int) -> Tensor:
    """[n,C] bin of each value, from what the rest of its row rounds to [n,C] and from the mean [] of all rows."""
    expected = (_TYPICAL * mean + rest) / (_TYPICAL * channels + channels - 1)
    return (UNIT_BIN + 4 * expected.clamp_min(1e-3).log2()).round().long().clamp(0, BINS - 1)


@functools.lru_cache(maxsize=4)
def _table(device: torch.device) -> Tensor:
    return torch.from_numpy(magnitude_bits(_HIGHEST)).to(device, non_blocking=True)
