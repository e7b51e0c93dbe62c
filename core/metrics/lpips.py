"""Learned perceptual image patch similarity (LPIPS v0.1, Zhang et al. 2018, arxiv.org/abs/1801.03924)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import conv2d, max_pool2d, relu

from streamlod.core.arrays import Float32, UInt8
from streamlod.core.metrics.lpips_weights import MIN_SIDE, Net, find_weights
from streamlod.core.metrics.pictures import unit_pair

_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)
_TINY = 1e-10

# For each net: a convolution as (stride, padding), a pooling as (window, stride), "tap" for a feature layer.
_Step = tuple[str, int, int]
_TAP: _Step = ("tap", 0, 0)
_ALEX_POOL: _Step = ("pool", 3, 2)
_PLANS: dict[Net, tuple[_Step, ...]] = {
    "alex": (
        *(("conv", 4, 2), _TAP, _ALEX_POOL),
        *(("conv", 1, 2), _TAP, _ALEX_POOL),
        *(("conv", 1, 1), _TAP) * 3,
    ),
    "vgg": (
        *(*(("conv", 1, 1),) * 2, _TAP, ("pool", 2, 2)) * 2,
        *(*(("conv", 1, 1),) * 3, _TAP, ("pool", 2, 2)) * 2,
        *(*(("conv", 1, 1),) * 3, _TAP),
    ),
}


@dataclass(frozen=True, slots=True, eq=False)
class Lpips:
    """The network, loaded once and used for many pictures.

    Attributes:
        net: ``alex`` or ``vgg``.
        convolutions: weight [out,in,h,w] and bias [out] of each layer.
        heads: [1,C,1,1] weights of each feature layer.
    """

    net: Net
    convolutions: tuple[tuple[Tensor, Tensor], ...]
    heads: tuple[Tensor, ...]

    @torch.no_grad()
    def distance(self, picture: UInt8 | Float32, truth: UInt8 | Float32) -> float:
        """LPIPS of `picture` against `truth`, 0 for equal ones.

        Args:
            picture, truth: [H,W,3], uint8 or floats in [0, 1], at least 32 pixels a side.

        Raises:
            ValueError: different shapes, smaller pictures, or numbers that are not finite.
        """
        pair = np.stack(unit_pair(picture, truth)).astype(np.float32)
        if min(pair.shape[1:3]) < MIN_SIDE:
            raise ValueError(f"LPIPS needs pictures of at least {MIN_SIDE} pixels a side, not {pair.shape[1:3]}")
        shift, scale = (torch.tensor(values).view(1, 3, 1, 1) for values in (_SHIFT, _SCALE))
        values = torch.from_numpy(pair).permute(0, 3, 1, 2) * 2 - 1
        return float(self._compare((values - shift) / scale))

    def _compare(self, values: Tensor) -> Tensor:
        """Sum over feature layers of the weighted squared difference of unit features, mean over places (eq. 1)."""
        convolutions, heads = iter(self.convolutions), iter(self.heads)
        total = torch.zeros(())
        for step, first, second in _PLANS[self.net]:
            if step == "conv":
                weight, bias = next(convolutions)
                values = relu(conv2d(values, weight, bias, first, second), inplace=True)
            elif step == "pool":
                values = max_pool2d(values, first, second)
            else:
                length = torch.linalg.vector_norm(values, dim=1, keepdim=True) + _TINY
                difference = (values[0] / length[0]).sub_(values[1] / length[1])
                total += difference.square_().mul_(next(heads)[0]).sum(dim=0).mean()
        return total


def load_lpips(net: Net, weights: Path | None = None) -> Lpips:
    """The network with its weights, from where `find_weights` finds them.

    Raises:
        BackendUnavailable: no weights are installed.
        InputError: a weight file that is not one.
    """
    found = find_weights(net, weights)
    convolutions = tuple((torch.from_numpy(weight), torch.from_numpy(bias)) for weight, bias in found.convolutions)
    heads = tuple(torch.from_numpy(head).view(1, -1, 1, 1) for head in found.heads)
    return Lpips(net, convolutions, heads)
