"""What one camera needs to render while one frame trains: on the CPU, only what moving Gaussians can change."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from core.camera import Camera
from core.gaussians import GaussianCloud
from core.render.backends import Backend
from core.render.differentiable import rasterise
from core.render.dirty import DirtyPlan, plan_dirty
from core.render.raster import Raster
from core.render.tiles import Box
from core.train.decode import Splats, join

_ROOM_PIXELS = 4.0  # how far a Gaussian's edge may travel before its camera is planned anew
_WHOLE = 0.7  # share of dirty tiles from which masking no longer pays


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """The still part of one camera's picture.

    Attributes:
        camera: whose picture.
        static: Gaussians that are drawn but not trained.
        plan: which tiles to render; None for all of them.
        base: [H,W,3] the picture outside of those tiles.
    """

    camera: Camera
    static: Splats
    plan: DirtyPlan | None = None
    base: Tensor | None = None

    @property
    def region(self) -> Box | None:
        """Pixels that the loss needs, None for all."""
        return None if self.plan is None else self.plan.box

    @property
    def is_empty(self) -> bool:
        """Whether no Gaussian that is trained reaches this picture."""
        return self.plan is not None and self.plan.box is None

    def covers(self, dynamic: Splats) -> bool:
        """Whether `dynamic`, where they are now, stay inside the planned tiles."""
        return self.plan is None or self.plan.covers(_cloud(dynamic))

    def render(self, dynamic: Splats, background: Tensor, backend: Backend) -> Raster:
        """The picture, with gradients for `dynamic`."""
        mask = None if self.plan is None else torch.from_numpy(self.plan.tile_mask)
        return rasterise(
            *join(dynamic, self.static).astuple(),
            camera=self.camera,
            background=background,
            gradient_rows=len(dynamic),
            tile_mask=mask,
            base=self.base,
            backend=backend,
        )


def make_stage(camera: Camera, dynamic: Splats, static: Splats, background: Tensor, backend: Backend) -> Stage:
    """Plan `camera`'s picture for `dynamic` Gaussians before `static` ones."""
    if backend != "cpu":
        return Stage(camera, static)
    plan = plan_dirty(camera, _cloud(dynamic), _cloud(static), _ROOM_PIXELS)
    if plan.share > _WHOLE:
        return Stage(camera, static)
    with torch.no_grad():
        everything = rasterise(*join(dynamic, static).astuple(), camera=camera, background=background, backend=backend)
    return Stage(camera, static.rows(torch.from_numpy(plan.static_rows)), plan, everything.image.detach())


def _cloud(splats: Splats) -> GaussianCloud:
    return GaussianCloud(*(part.detach().contiguous().numpy() for part in splats.astuple()))
