"""The training pictures of a later frame at one size: what each camera should show, and how it is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from streamlod.core.render.backends import Backend
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.later_frame.comparison import Comparison
from streamlod.core.train.later_frame.tile_cache import TileCache, make_tile_cache
from streamlod.core.train.pictures.boxes import tiles_near


@dataclass(frozen=True, slots=True, eq=False)
class PlannedViews:
    """Cameras whose pictures are planned one by one, when they are first needed.

    Attributes:
        pictures: what the cameras should show, and what they showed before.
        static: Gaussians that are drawn but not trained, by camera. backgrounds: [C,3] what each films of nothing.
        backend: of the rasteriser.
        caches: plans so far, by camera. weights: [H,W,3] of absolute errors so far, by camera.
    """

    pictures: Comparison
    static: Sequence[Splats]
    backgrounds: Tensor
    backend: Backend
    caches: dict[int, TileCache] = field(default_factory=dict)
    weights: dict[int, Tensor] = field(default_factory=dict)

    def plan(self, number: int, trained: Splats) -> TileCache:
        """How camera `number` is drawn; planned now for the Gaussians `trained`, if it was not before."""
        if number not in self.caches:
            active = tiles_near(self.pictures.masks[number].cpu().numpy(), 0)
            with torch.no_grad():
                self.caches[number] = make_tile_cache(
                    self.pictures.views.cameras[number],
                    trained,
                    self.static[number],
                    self.backgrounds[number],
                    self.backend,
                    active,
                    self._known(number),
                )
        return self.caches[number]

    @torch.no_grad()
    def allow_for_size(self, number: int, before: Splats) -> None:
        """Let camera `number` ask only for what has changed, when its picture is smaller than the one filmed.

        Gaussians are drawn a little wider in small pictures. What was right at full size must not be trained for that.

        Args:
            before: the Gaussians that are trained, as they were in the picture that is shown.
        """
        known = self._known(number)
        if known is not None:
            self.pictures.views.targets[number] += self.caches[number].render(before).image - known

    def pixel_weights(self, number: int, changed_weight: float) -> Tensor | None:
        """[H,W,3] of one picture's absolute errors: those of changed pixels count more."""
        if number not in self.weights and changed_weight:
            counted = 1 + changed_weight * self.pictures.masks[number, ..., None].to(self.pictures.views.targets.dtype)
            self.weights[number] = counted.expand(-1, -1, 3).contiguous()
        return self.weights.get(number)

    def _known(self, number: int) -> Tensor | None:
        """[H,W,3] picture that camera `number` would film of the state before, if it is known."""
        shown = self.pictures.known.shown[number]
        return None if bool(shown[0, 0, 0].isnan()) else shown
