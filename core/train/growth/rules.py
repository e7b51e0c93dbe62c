"""The growth rule: where a first frame adds anchors, and which it removes."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from streamlod.core.train.field.field import Field
from streamlod.core.train.growth.gradient import GrowthStatistics, NewAnchors, earned_extra_level, grow
from streamlod.core.train.growth.new_anchors import strongest


@dataclass(frozen=True, slots=True)
class GradientGrowth:
    """The rule of Octree-GS: grow where view-space gradients are large, remove what is nearly transparent.

    Attributes:
        threshold: of the mean view-space gradient norm, from which level 0 grows; it rises with the level.
        prune_opacity: summed over an anchor's Gaussians and averaged over visits, below which it is removed.
        extra_level_gain: levels that an anchor earns at a refinement (docs/method.md, reading 3).
    """

    threshold: float
    prune_opacity: float = 0.0
    extra_level_gain: float = 0.0

    def new_anchors(
        self, field: Field, statistics: GrowthStatistics, highest: int, most: int, occupied: Field | None = None
    ) -> NewAnchors:
        """Anchors to add; where more would grow than may, those with the largest gradients do.

        Args:
            field: N anchors that were trained.
            statistics: of the steps since the last refinement.
            highest: finest level that may receive anchors.
            most: anchors that may be added.
            occupied: all anchors there are, where `field` holds some of them only.
        """
        gradient = statistics.mean_gradient()
        new = grow(field, gradient, self.threshold, highest, occupied)
        return strongest(new, gradient.reshape(len(field), -1), most)

    def extra_levels(self, field: Field, statistics: GrowthStatistics) -> Tensor:
        """[N] float32 levels by which each anchor is drawn from farther away from now on."""
        earned = earned_extra_level(field, statistics.mean_gradient(), self.threshold)
        return earned.float() * self.extra_level_gain

    def removed(self, statistics: GrowthStatistics) -> Tensor:
        """[N] bool: anchors to remove."""
        return statistics.faint(self.prune_opacity)
