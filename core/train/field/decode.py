"""Anchors to Gaussians in torch: the differentiable twin of `core.scene.expand`, tested against it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numba
import torch
from torch import Tensor

from streamlod.core.scene.gaussians import MAX_LOG_SCALE, GaussianCloud
from streamlod.core.train.kernels import decode as kernels


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """The shared network; shapes as in `core.scene.anchors.AnchorWeights`."""

    hidden_weight: Tensor
    hidden_bias: Tensor
    output_weight: Tensor
    output_bias: Tensor

    def parameters(self) -> list[Tensor]:
        """The four arrays, for an optimiser."""
        return [self.hidden_weight, self.hidden_bias, self.output_weight, self.output_bias]


@dataclass(frozen=True, slots=True, eq=False)
class Splats:
    """G = N * K Gaussians, one block of K an anchor; opacities at or below zero are not drawn.

    Attributes: means [G,3], quaternions [G,4], scales [G,3], opacities [G], colours [G,3].
    """

    means: Tensor
    quaternions: Tensor
    scales: Tensor
    opacities: Tensor
    colours: Tensor

    def __len__(self) -> int:
        return len(self.opacities)

    def astuple(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """The five arrays in the order that `rasterise` takes them."""
        return self.means, self.quaternions, self.scales, self.opacities, self.colours

    def rows(self, index: Tensor) -> Splats:
        """Only the Gaussians of `index`."""
        return Splats(*(part[index] for part in self.astuple()))

    def cloud(self) -> GaussianCloud:
        """The same values for kernels; on the CPU only."""
        return GaussianCloud(*(part.detach().contiguous().numpy() for part in self.astuple()))

    def detached(self) -> Splats:
        """The same values, outside of the graph."""
        return Splats(*(part.detach() for part in self.astuple()))


def join(first: Splats, second: Splats) -> Splats:
    """The Gaussians of `first`, then those of `second`."""
    return Splats(*(torch.cat(pair) for pair in zip(first.astuple(), second.astuple(), strict=True)))


def decode(inputs: Tensor, offset: Tensor, scaling: Tensor, position: Tensor, network: Network) -> Splats:
    """Gaussians of N anchors.

    Args:
        inputs: [N,I] what the network sees; offset: [N,K,3]; scaling: [N,6] log-scales; position: [N,3] world.
    """
    hidden = torch.addmm(network.hidden_bias, inputs, network.hidden_weight).relu_()
    given = (torch.addmm(network.output_bias, hidden, network.output_weight), offset, scaling, position)
    by_numba = all(value.device.type == "cpu" and value.dtype == torch.float32 for value in given)
    return Splats(*(_Fused if by_numba else _OnDevice).apply(*given))  # type: ignore[no-untyped-call]


class _OnDevice(torch.autograd.Function):
    """The parts of `Splats` of the network's outputs [N,11K], by torch for any device and float type.

    The gradient is written down, which takes fewer launches.
    """

    @staticmethod
    def forward(ctx: Any, outputs: Tensor, offset: Tensor, scaling: Tensor, position: Tensor) -> tuple[Tensor, ...]:
        count, slots = offset.shape[:2]
        opacity, colour, relative, rotation = torch.split(outputs, [slots, 3 * slots, 3 * slots, 4 * slots], dim=1)
        size = scaling.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE).exp()[:, None]
        scales = (size[..., 3:] * relative.reshape(count, slots, 3).sigmoid()).reshape(-1, 3)
        opacities, colours = opacity.tanh().reshape(-1), colour.sigmoid().reshape(-1, 3)
        ctx.save_for_backward(offset, scaling, size, scales, opacities, colours)
        means = torch.addcmul(position[:, None], offset, size[..., :3]).reshape(-1, 3)
        return means, rotation.reshape(-1, 4) + _upright(outputs.device, outputs.dtype), scales, opacities, colours

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor, ...]:
        offset, scaling, size, scales, opacities, colours = ctx.saved_tensors
        by_means, by_quaternions, by_scales, by_opacities, by_colours = upstream
        count, slots = offset.shape[:2]
        pulled, widened = by_means.reshape(offset.shape), (by_scales * scales).reshape(offset.shape)
        dimmed, tinted = by_opacities * opacities, by_colours * colours
        outputs = torch.cat(
            [
                torch.addcmul(by_opacities, dimmed, opacities, value=-1).reshape(count, slots),
                torch.addcmul(tinted, tinted, colours, value=-1).reshape(count, 3 * slots),
                torch.addcdiv(widened, widened * scales.reshape(offset.shape), size[..., 3:], value=-1).flatten(1),
                by_quaternions.reshape(count, 4 * slots),
            ],
            dim=1,
        )
        moved = pulled * size[..., :3]
        to_size = torch.cat([moved * offset, widened], dim=2).sum(dim=1)
        return outputs, moved, to_size * (scaling.abs() <= MAX_LOG_SCALE), pulled.sum(dim=1)


@lru_cache(maxsize=8)
def _upright(device: torch.device, dtype: torch.dtype) -> Tensor:
    """[4] the quaternion of no turn, made on the device."""
    return (torch.arange(4, device=device) == 0).to(dtype)


class _Fused(torch.autograd.Function):
    """The same on the CPU, in one numba pass each way."""

    @staticmethod
    def forward(ctx: Any, outputs: Tensor, offset: Tensor, scaling: Tensor, position: Tensor) -> tuple[Tensor, ...]:
        count, slots = offset.shape[:2]
        size = torch.empty(count, 6)
        means, scales, colours = (torch.empty(count * slots, 3) for _ in range(3))
        parts = (means, torch.empty(count * slots, 4), scales, torch.empty(count * slots), colours)
        found = (_rows(part, count, slots) for part in parts)
        kernels.activate(
            _workers(count), *_arrays(outputs, _rows(offset, count, slots), scaling, position, size, *found)
        )
        ctx.save_for_backward(offset, scaling, size, *parts[2:])
        return parts

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor, ...]:
        offset, scaling, size, *parts = ctx.saved_tensors
        count, slots = offset.shape[:2]
        known = (_rows(offset, count, slots), scaling, size, *(_rows(part, count, slots) for part in parts))
        by = (_rows(gradient, count, slots) for gradient in upstream)
        found = tuple(torch.empty(count, width) for width in (11 * slots, 3 * slots, 6, 3))
        kernels.differentiate(_workers(count), *_arrays(*known, *by, *found))
        to_outputs, to_offset, to_scaling, to_position = found
        return to_outputs, to_offset.view(offset.shape), to_scaling, to_position


def _rows(values: Tensor, count: int, slots: int) -> Tensor:
    """[N,K*C] of values [N,K,C], [N*K,C] or [N*K]; widths are counted, as torch cannot tell those of no rows."""
    width = values.shape[-1] if values.ndim > 1 else 1
    return values.reshape(count, slots * width)


def _workers(count: int) -> int:
    return max(1, min(numba.get_num_threads(), count))


def _arrays(*tensors: Tensor) -> list[Any]:
    return [tensor.detach().contiguous().numpy() for tensor in tensors]
