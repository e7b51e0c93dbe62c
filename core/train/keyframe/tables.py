"""Tables of a first frame's anchors that its steps look up; made anew whenever anchors come or go."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from streamlod.core.train.field.field import Field
from streamlod.core.train.field.rounding import Precision
from streamlod.core.train.growth.gradient import GrowthStatistics
from streamlod.core.train.keyframe.support import in_view, support
from streamlod.core.train.pictures.views import Views

_LEAST_PRICE = 0.25  # of the price on opacity, for what one camera alone sees: what no picture needs still goes


@dataclass(frozen=True, slots=True, eq=False)
class AnchorTables:
    """Facts about N anchors of K Gaussians each.

    Attributes:
        up_to: rows of the anchors up to each level, None for all. On a GPU the host would wait for them in every step.
        backgrounds: by camera, the share of steps that draw it over a random colour.
        level: [N,K] level of each Gaussian's anchor. support: [N,K] share of the dropout rate that holds for it.
        price: [N,K] share of the price on opacity that it pays. hiding: [N,K] its further price, for what it hides.
        statistics: of gradients and opacities since the tables were made.
        precision: with which the anchors are rounded; None until it is measured.
    """

    up_to: list[Tensor | None]
    backgrounds: dict[int, float]
    level: Tensor
    support: Tensor
    price: Tensor
    hiding: Tensor
    statistics: GrowthStatistics
    precision: Precision | None = None

    def of_gaussians(self, rows: Tensor | None) -> tuple[Tensor, ...]:
        """[G] level, support, price and hiding of the Gaussians of the anchors `rows`, None for all."""
        tables = self.level, self.support, self.price, self.hiding
        return tuple((table if rows is None else table[rows]).flatten() for table in tables)


def tables_of(field: Field, views: Views, hiding: Tensor, *, by_support: bool) -> AnchorTables:
    """The tables of `field`, trained on the usable `views`; nothing is measured yet.

    Args:
        hiding: [N,K], see `AnchorTables`. by_support: whether it counts how many cameras agree on an anchor.
    """
    cameras = [views.cameras[number] for number in views.usable]
    visible = in_view(field.position, cameras)
    supported = support(visible, field.position, cameras) if by_support else torch.ones_like(field.extra_level)
    agreement = ((visible * supported).sum(dim=1) / visible.sum(dim=1).clamp_min(1)).tolist()
    of_anchors = field.level, supported, _LEAST_PRICE + (1 - _LEAST_PRICE) * supported
    level, supported, price = (part.repeat_interleave(field.slots).view(len(field), -1) for part in of_anchors)
    up_to = [torch.nonzero(field.level <= highest)[:, 0] for highest in range(field.octree.levels - 1)]
    backgrounds = dict(zip(views.usable, agreement, strict=True))
    statistics = GrowthStatistics(len(field), field.slots, field.level.device)
    return AnchorTables([*up_to, None], backgrounds, level, supported, price, hiding, statistics)
