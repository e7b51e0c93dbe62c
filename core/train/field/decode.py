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

    What follows the network is one numba pass on the CPU.

    Args:
        inputs: [N,I] what the network sees; offset: [N,K,3]; scaling: [N,6] log-scales; position: [N,3] world.
    """
    given = (inputs, offset, scaling, position, *network.parameters())
    if all(value.device.type == "cpu" and value.dtype == torch.float32 for value in given):
        return Splats(*_Fused.apply(*given))  # type: ignore[no-untyped-call]
    return Splats(*_OnDevice.apply(*given))  # type: ignore[no-untyped-call]


def _activated(
    outputs: Tensor, offset: Tensor, scaling: Tensor, position: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """The parts of `Splats` of the network's outputs [N,11K]."""
    count, slots = offset.shape[:2]
    opacity, colour, relative, rotation = torch.split(outputs, [slots, 3 * slots, 3 * slots, 4 * slots], dim=1)
    size = scaling.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE).exp()
    upright = _upright(outputs.device, outputs.dtype)
    return (
        torch.addcmul(position[:, None], offset, size[:, None, :3]).reshape(-1, 3),
        rotation.reshape(-1, 4) + upright,
        (size[:, None, 3:] * relative.reshape(count, slots, 3).sigmoid()).reshape(-1, 3),
        opacity.tanh().reshape(-1),
        colour.sigmoid().reshape(-1, 3),
    )


@lru_cache(maxsize=8)
def _upright(device: torch.device, dtype: torch.dtype) -> Tensor:
    """[4] the quaternion of no turn, made on the device."""
    return (torch.arange(4, device=device) == 0).to(dtype)


def _differentiated(
    offset: Tensor, scaling: Tensor, scales: Tensor, opacities: Tensor, colours: Tensor, *upstream: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The derivatives of `_activated` by its four arguments, from derivatives by its five results."""
    count, slots = offset.shape[:2]
    by_means, by_quaternions, by_scales, by_opacities, by_colours = upstream
    size = scaling.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE).exp()[:, None]
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


class _OnDevice(torch.autograd.Function):
    """`decode` by torch in few launches, for any device and float type: the gradient is written down."""

    @staticmethod
    def forward(ctx: Any, *given: Tensor) -> tuple[Tensor, ...]:
        inputs, offset, scaling, position, hidden_weight, hidden_bias, output_weight, output_bias = given
        hidden = torch.addmm(hidden_bias, inputs, hidden_weight).relu_()
        parts = _activated(torch.addmm(output_bias, hidden, output_weight), offset, scaling, position)
        ctx.save_for_backward(inputs, offset, scaling, hidden_weight, output_weight, hidden, *parts[2:])
        return parts

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        inputs, offset, scaling, hidden_weight, output_weight, hidden, *parts = ctx.saved_tensors
        to_outputs, *found = _differentiated(offset, scaling, *parts, *upstream)
        products = _through_network(ctx, inputs, hidden, hidden_weight, output_weight, to_outputs)
        return (products[0], *found, *products[1:])


def _through_network(
    ctx: Any, inputs: Tensor, hidden: Tensor, hidden_weight: Tensor, output_weight: Tensor, to_outputs: Tensor
) -> tuple[Tensor | None, ...]:
    """Derivatives by the inputs and the four arrays of the network, from those by its outputs [N,11K]."""
    needed = ctx.needs_input_grad
    to_hidden = (to_outputs @ output_weight.T).mul_(hidden > 0)
    return (
        to_hidden @ hidden_weight.T if needed[0] else None,
        inputs.T @ to_hidden if needed[4] else None,
        to_hidden.sum(dim=0) if needed[5] else None,
        hidden.T @ to_outputs if needed[6] else None,
        to_outputs.sum(dim=0) if needed[7] else None,
    )


class _Fused(torch.autograd.Function):
    """`decode` on the CPU: torch's matrix products, numba for all that is done number by number."""

    @staticmethod
    def forward(ctx: Any, *given: Tensor) -> tuple[Tensor, ...]:
        inputs, offset, scaling, position, hidden_weight, hidden_bias, output_weight, output_bias = given
        count, slots = offset.shape[:2]
        hidden = torch.addmm(hidden_bias, inputs, hidden_weight).relu_()
        outputs = torch.addmm(output_bias, hidden, output_weight)
        size = torch.empty(count, 6)
        widths = (3, 4, 3, 1, 3)  # of means, quaternions, scales, opacities, colours
        found = tuple(torch.empty(count, width * slots) for width in widths)
        kernels.activate(
            _workers(count), *_arrays(outputs, offset.reshape(count, 3 * slots), scaling, position, size, *found)
        )
        means, quaternions, scales, opacities, colours = found
        parts = (
            means.view(-1, 3),
            quaternions.view(-1, 4),
            scales.view(-1, 3),
            opacities.view(-1),
            colours.view(-1, 3),
        )
        # the views, since those are the outputs that autograd watches for changes in place
        ctx.save_for_backward(inputs, offset, scaling, hidden_weight, output_weight, hidden, size, *parts[2:])
        return parts

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        inputs, offset, scaling, hidden_weight, output_weight, hidden, size, *parts = ctx.saved_tensors
        count, slots = offset.shape[:2]
        # widths in numbers: of no rows, torch cannot tell them
        known = (offset.reshape(count, 3 * slots), scaling, size, *(_rows(part, count, slots) for part in parts))
        by = (_rows(gradient, count, slots) for gradient in upstream)
        to_outputs, to_offset, to_scaling, to_position = (
            torch.empty(count, width) for width in (11 * slots, 3 * slots, 6, 3)
        )
        found = (to_outputs, to_offset, to_scaling, to_position)
        kernels.differentiate(_workers(count), *_arrays(*known, *by, *found))
        products = _through_network(ctx, inputs, hidden, hidden_weight, output_weight, to_outputs)
        return (products[0], to_offset.view(offset.shape), to_scaling, to_position, *products[1:])


def _rows(values: Tensor, count: int, slots: int) -> Tensor:
    """[N,K*C] of values [N*K,C] or [N*K]."""
    return values.reshape(count, slots * values.shape[1:].numel())


def _workers(count: int) -> int:
    return max(1, min(numba.get_num_threads(), count))


def _arrays(*tensors: Tensor) -> list[Any]:
    return [tensor.detach().contiguous().numpy() for tensor in tensors]
