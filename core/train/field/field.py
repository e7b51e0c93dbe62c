"""The anchors of a scene as torch tensors, while they are trained."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from streamlod.core.scene.octree import Octree
from streamlod.core.train.field.decode import Network, Splats, decode


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """N anchors of all levels in one list.

    Attributes:
        octree: geometry of the grid.
        reference_distance: d_max in world units.
        view_dependent: whether the network sees the view.
        level: [N] int64; voxel: [N,3] int32 grid nodes; extra_level: [N] float32, in levels.
        position: [N,3] float32 world positions.
        feature: [N,F]; offset: [N,K,3]; scaling: [N,6] log-scales.
        network: shared by all anchors.
        by_distance: draw only the anchors that a camera's distance calls for (paper section IV-A).
    """

    octree: Octree
    reference_distance: float
    view_dependent: bool
    level: Tensor
    voxel: Tensor
    extra_level: Tensor
    position: Tensor
    feature: Tensor
    offset: Tensor
    scaling: Tensor
    network: Network
    by_distance: bool = False

    def __len__(self) -> int:
        return len(self.level)

    @property
    def slots(self) -> int:
        """K, Gaussians an anchor."""
        return self.offset.shape[1]

    @property
    def gaussian_means(self) -> Tensor:
        """[N,K,3] where the Gaussians are in the world."""
        return self.position[:, None] + self.offset * self.scaling.exp()[:, None, :3]

    @property
    def looks_the_same(self) -> bool:
        """Whether every camera gets the same Gaussians."""
        return not (self.view_dependent or self.by_distance)

    def decode(self, centre: Tensor, rows: Tensor | None = None) -> Splats:
        """Gaussians of `rows` (all by default) for a camera at `centre` [3]; those not called for are transparent."""
        if rows is not None:
            return self.with_rows(rows).decode(centre)
        inputs = self.feature
        if self.view_dependent:
            away = self.position.detach() - centre
            distance = away.norm(dim=1, keepdim=True).clamp_min(1e-12)
            inputs = torch.cat([self.feature, away / distance, distance / self.reference_distance], dim=1)
        splats = decode(inputs, self.offset, self.scaling, self.position, self.network)
        if not self.by_distance:
            return splats
        drawn = visible_levels(self, centre, self.octree.levels - 1)
        return replace(splats, opacities=splats.opacities * drawn.repeat_interleave(self.slots))

    def to(self, device: str) -> Field:
        """The same anchors on another device."""
        network = Network(*(value.to(device) for value in self.network.parameters()))
        return replace(self._mapped(lambda _, value: value.to(device)), network=network)

    def with_rows(self, rows: Tensor) -> Field:
        """Only the anchors of `rows`."""
        return self._mapped(lambda _, value: value[rows])

    def with_values(self, rows: Tensor, other: Field) -> Field:
        """The values of `other` at `rows`, these everywhere else."""
        return self._mapped(lambda name, value: value.index_copy(0, rows, getattr(other, name)[rows]))

    def with_appended(self, rows: dict[str, Tensor]) -> Field:
        """These anchors, then `rows`, which names all seven arrays."""
        return self._mapped(lambda name, value: torch.cat([value, rows[name]]))

    def _mapped(self, change: Callable[[str, Tensor], Tensor]) -> Field:
        """`change` of the name and value of each of the seven arrays."""
        return replace(
            self,
            level=change("level", self.level),
            voxel=change("voxel", self.voxel),
            extra_level=change("extra_level", self.extra_level),
            position=change("position", self.position),
            feature=change("feature", self.feature),
            offset=change("offset", self.offset),
            scaling=change("scaling", self.scaling),
        )


def visible_levels(field: Field, centre: Tensor, highest: int) -> Tensor:
    """[N] bool: anchors that the distance to a camera at `centre` [3] calls for (paper section IV-A).

    The torch twin of `core.scene.octree.level_for_distance`.
    """
    distance = (field.position - centre).norm(dim=1).clamp_min(1e-12)
    wanted = torch.log2(field.reference_distance / distance) + field.extra_level
    return field.level <= wanted.round().clamp(0, highest)
