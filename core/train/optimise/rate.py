"""The bits of a frame's residual, as a term of the loss: the codec's own tables, so that training pays what is sent.

A value is coded under a bin of its expected magnitude. Here, as in the codec, that expectation comes from the other
values of the anchor and from the average anchor; it is a constant to the gradient. Between integers the cost is
interpolated linearly.
"""

from __future__ import annotations

import functools

import numba
import numpy as np
import torch
from torch import Tensor

from streamlod.core.scene.anchors import LATENTS
from streamlod.core.scene.entropy_model import BINS, UNIT_BIN, magnitude_bits
from streamlod.core.scene.quantise import DEFAULT_OFFSET
from streamlod.core.train.kernels import rate as kernels
from streamlod.core.train.loss.known_gradient import with_gradient

SET_BITS = 4.0  # about what it costs that an anchor changes at all: its place in the dynamic set
_TYPICAL = 0.5  # weight of the average anchor beside the anchor's own other values
_LEAST = 1e-3  # expected magnitude
_HIGHEST, _BELOW = 64, 0.01  # magnitudes count as at most so much below the highest of the table
_TABLE = magnitude_bits(_HIGHEST)


def residual_bits(latent: Tensor, position: Tensor) -> Tensor:
    """[] bits of the residuals of n anchors; value and gradient are made together, on the CPU in one numba pass.

    Args:
        latent: [n,24], position: [n,3] real numbers in steps, before they are rounded.
    """
    if any(values.device.type != "cpu" or values.dtype != torch.float32 for values in (latent, position)):
        values = torch.cat([latent, position], dim=1)
        bits, gradient = _priced(values)
        return with_gradient(bits, [values], [gradient])
    arrays = [tensor.detach().contiguous().numpy() for tensor in (latent, position)]
    gradients = [np.empty(array.shape, np.float32) for array in arrays]
    sums = np.zeros((max(1, min(numba.get_num_threads(), len(latent))), 3))
    found = kernels.residual_bits(sums, *arrays, _TABLE, _TYPICAL, np.float32(SET_BITS), *gradients)
    return with_gradient(latent.new_tensor(found), [latent, position], list(map(torch.from_numpy, gradients)))


@torch.no_grad()
def _priced(values: Tensor) -> tuple[Tensor, Tensor]:
    """[] bits of the latents and positions [n,27] of n anchors, and their derivatives."""
    table, steeper, parts, spread, own = _constants(values.device, values.dtype)
    magnitude = values.abs()
    size = magnitude.clamp(max=_HIGHEST - _BELOW)
    rounded, lower = (size + DEFAULT_OFFSET).floor(), size.floor()
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
    parts = np.zeros((LATENTS + 3, 2))
    parts[:LATENTS, 0], parts[LATENTS:, 1] = 1, 1
    channels = parts.sum(axis=0)
    spread = (parts / (_TYPICAL * channels + channels - 1)).T
    arrays = _TABLE[:, :-1].ravel(), np.diff(_TABLE, axis=1).ravel(), parts, spread, spread.sum(axis=0)
    return tuple(torch.from_numpy(array).to(device, dtype, non_blocking=True) for array in arrays)
