"""The bits of a frame's residual, as a term of the loss: the codec's own tables, so that training pays what is sent.

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

from streamlod.core.scene.anchors import LATENTS
from streamlod.core.scene.entropy_model import BINS, UNIT_BIN, magnitude_bits
from streamlod.core.scene.quantise import DEFAULT_OFFSET
from streamlod.core.train.kernels import rate as kernels

SET_BITS = 4.0  # about what it costs that an anchor changes at all: its place in the dynamic set
_TYPICAL = 0.5  # weight of the average anchor beside the anchor's own other values
_LEAST = 1e-3  # expected magnitude
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
    """`residual_bits_reference` in few launches: latents and positions together, with an explicit gradient."""

    @staticmethod
    def forward(ctx: Any, latent: Tensor, position: Tensor) -> Tensor:
        bits, ctx.gradient = _priced(torch.cat([latent, position], dim=1))
        return bits

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, ...]:
        return torch.split(ctx.gradient * upstream, [LATENTS, 3], dim=1)


def _priced(values: Tensor) -> tuple[Tensor, Tensor]:
    """[] bits of the latents and positions [n,27] of n anchors, and their derivatives."""
    table, steeper, parts, spread, own = _constants(values.device, values.dtype)
    magnitude = values.abs()
    size = magnitude.clamp(max=_HIGHEST - _BELOW)
    rounded, lower = _rounded(size), size.floor()
    sums = rounded @ parts
    expected = torch.addcmul(torch.add(sums, sums.mean(dim=0), alpha=_TYPICAL) @ spread, rounded, own, value=-1)
    bins = (expected.clamp_min(_LEAST).log2() * 4 + UNIT_BIN).round().clamp(0, BINS - 1)
    place = torch.add(lower, bins, alpha=_HIGHEST).long().clamp(0, len(table) - 1)  # inside, whatever becomes of NaN
    slope, largest = steeper[place], magnitude.amax(dim=1, keepdim=True)
    bits = torch.addcmul(table[place], size - lower, slope).sum() + SET_BITS * largest.clamp(max=1).sum()
    first = magnitude == largest  # shared among the largest, as torch shares the gradient of a maximum
    shared = SET_BITS * (largest <= 1) / first.sum(dim=1, keepdim=True)
    return bits, (slope * (magnitude <= _HIGHEST - _BELOW) + first * shared) * values.sign()


@functools.lru_cache(maxsize=4)
def _constants(device: torch.device, dtype: torch.dtype) -> tuple[Tensor, ...]:
    """The factors of `_priced`; kept on the device.

    Returns:
        [BINS * _HIGHEST] bits of each magnitude in each bin; [BINS * _HIGHEST] how many more bits the next magnitude
        takes; [27,2] 1 where a value is a latent, and where it is a position; [2,27] and [27] factors of the sums over
        latents and positions, and of the value itself, in the expected magnitude.
    """
    bits = magnitude_bits(_HIGHEST)
    parts = np.zeros((LATENTS + 3, 2))
    parts[:LATENTS, 0], parts[LATENTS:, 1] = 1, 1
    channels = parts.sum(axis=0)
    spread = (parts / (_TYPICAL * channels + channels - 1)).T
    arrays = bits[:, :-1].ravel(), np.diff(bits, axis=1).ravel(), parts, spread, spread.sum(axis=0)
    return tuple(torch.from_numpy(array).to(device, dtype, non_blocking=True) for array in arrays)


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
    """Quantised magnitudes."""
    return (size + DEFAULT_OFFSET).floor()


def _bins(rest: Tensor, mean: Tensor, channels: int) -> Tensor:
    """[n,C] bin of each value, from what the rest of its row rounds to [n,C] and from the mean [] of all rows."""
    expected = (_TYPICAL * mean + rest) / (_TYPICAL * channels + channels - 1)
    return (UNIT_BIN + 4 * expected.clamp_min(_LEAST).log2()).round().long().clamp(0, BINS - 1)


@functools.lru_cache(maxsize=4)
def _table(device: torch.device) -> Tensor:
    return torch.from_numpy(magnitude_bits(_HIGHEST)).to(device, non_blocking=True)
