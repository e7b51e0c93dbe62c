"""One camera of a later frame's training at one size: what it should show, and how it is drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from streamlod.core.render.backends import Backend
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.later_frame.autograd.tile_cache import TileCache, make_tile_cache
from streamlod.core.train.later_frame.comparison import Comparison


@dataclass(frozen=True, slots=True, eq=False)
class PlannedView:
    """A camera that trains.

    Attributes:
        target: [H,W,3] what it should show.
        shown: [H,W,3] what it would film of the state before; None where that is not known.
        weights: [H,W,3] of the absolute errors; None for ones.
        cache: draws it.
    """

    target: Tensor
    shown: Tensor | None
    weights: Tensor | None
    cache: TileCache

    @torch.no_grad()
    def allowing_for_size(self, before: Splats) -> PlannedView:
        """The same, asking only for what has changed, where its picture is smaller than the one filmed.

        Gaussians are drawn a little wider in small pictures. What was right at full size must not be trained for that.

        Args:
            before: the Gaussians that are trained, as they were in the picture that is shown.
        """
        if self.shown is None:
            return self
        return replace(self, target=self.target + (self.cache.render(before).image - self.shown))


@torch.no_grad()
def planned_view(
    pictures: Comparison,
    number: int,
    trained: Splats,
    static: Splats,
    background: Tensor,
    backend: Backend,
    changed_weight: float,
) -> PlannedView:
    """Plan camera `number` of `pictures` for the Gaussians `trained` before those that are only drawn.

    Args:
        background: [3] behind all of them. changed_weight: how much more the error of a changed pixel counts.
    """
    target, mask, shown = pictures.views.targets[number], pictures.masks[number], pictures.known.shown[number]
    known = None if bool(shown[0, 0, 0].isnan()) else shown
    weights = None
    if changed_weight:
        weights = (1 + changed_weight * mask[..., None].to(target.dtype)).expand(-1, -1, 3).contiguous()
    active = pictures.changed_tiles(number)
    cache = make_tile_cache(pictures.views.cameras[number], trained, static, background, backend, active, known)
    return PlannedView(target, known, weights, cache)
