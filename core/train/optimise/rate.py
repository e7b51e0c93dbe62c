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
_HIGHEST = 64


def residual_bits(latent: Tensor, position: Tensor) -> Tensor:
    """[] bits of the residuals of n anchors; on the CPU, value and gradient are one numba pass.

    Args:
        latent: [n,24], position: [n,3] real numbers in steps, before they are rounded.
    """
    if all(values.device.type == "cpu" and values.dtype == torch.float32 for values in (latent, position)):
        bits: Tensor = _Fused.apply(latent, position)  # type: ignore[no-untyped-call]
        return bits
    return residual_bits_reference(latent, position)


def residual_bits_reference(latent: Tensor, position: Tensor) -> Tensor:
    """`residual_bits` by torch, on any device and for any float type."""
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


def _coded_bits(values: Tensor) -> Tensor:
    """[] bits of values [n,C] coded row by row."""
    size = values.abs().clamp(max=_HIGHEST - 0.01)
    lower = size.detach().floor().long()
    table = _table(values.device)
    bins = _bins(size.detach())
    cost, next_cost = table[bins, lower], table[bins, lower + 1]
    return (cost + (size - lower) * (next_cost - cost)).sum()


def _bins(size: Tensor) -> Tensor:
    """[n,C] bin of each value, from what the rest of its row rounds to and from the mean over all."""
    rounded = (size + DEFAULT_OFFSET).floor()
    channels = size.shape[1]
    rest = rounded.sum(dim=1, keepdim=True) - rounded
    expected = (_TYPICAL * channels * rounded.mean() + rest) / (_TYPICAL * channels + channels - 1)
    return (UNIT_BIN + 4 * expected.clamp_min(1e-3).log2()).round().clamp(0, BINS - 1).long()


@functools.lru_cache(maxsize=4)
def _table(device: torch.device) -> Tensor:
    return torch.from_numpy(magnitude_bits(_HIGHEST)).to(device)
