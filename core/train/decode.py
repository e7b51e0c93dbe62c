"""Anchors to Gaussians in torch: the differentiable twin of `core.expand`, tested against it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from core.expand import LOG_SCALE_LIMIT
from core.gaussians import GaussianCloud


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """The shared network; shapes as in `core.anchors.AnchorWeights`."""

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


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What a view-dependent network sees of a camera: its centre [3] and d_max in world units."""

    centre: Tensor
    reference_distance: float


def decode(
    feature: Tensor, offset: Tensor, scaling: Tensor, position: Tensor, network: Network, view: View | None
) -> Splats:
    """Gaussians of N anchors.

    Args:
        feature: [N,F]; offset: [N,K,3]; scaling: [N,6] log-scales; position: [N,3] world.
        view: where from, for a view-dependent network; None otherwise.
    """
    count, slots = offset.shape[:2]
    inputs = feature
    if view is not None:
        away = position.detach() - view.centre
        distance = away.norm(dim=1, keepdim=True).clamp_min(1e-12)
        inputs = torch.cat([feature, away / distance, distance / view.reference_distance], dim=1)
    hidden = torch.addmm(network.hidden_bias, inputs, network.hidden_weight).relu()
    outputs = torch.addmm(network.output_bias, hidden, network.output_weight)
    sizes = [slots, 3 * slots, 3 * slots, 4 * slots]
    opacity, colour, relative, rotation = torch.split(outputs, sizes, dim=1)
    size = scaling.clamp(-LOG_SCALE_LIMIT, LOG_SCALE_LIMIT).exp()
    upright = torch.tensor([1.0, 0.0, 0.0, 0.0], device=rotation.device)
    return Splats(
        means=(position[:, None] + offset * size[:, None, :3]).reshape(-1, 3),
        quaternions=rotation.reshape(-1, 4) + upright,
        scales=(size[:, None, 3:] * relative.reshape(count, slots, 3).sigmoid()).reshape(-1, 3),
        opacities=opacity.tanh().reshape(-1),
        colours=colour.sigmoid().reshape(-1, 3),
    )
