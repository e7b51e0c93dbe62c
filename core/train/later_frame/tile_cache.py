"""Rendering one camera while one frame trains: on the CPU, only tiles that trained Gaussians can change are drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool, Float32
from streamlod.core.camera import Camera
from streamlod.core.render.backends import Backend
from streamlod.core.render.cpu.autograd import rasterise_over
from streamlod.core.render.cpu.backdrop import Backdrop, prepare
from streamlod.core.render.cpu.dirty_tiles import touched_tiles
from streamlod.core.render.differentiable import rasterise
from streamlod.core.render.raster import Raster
from streamlod.core.render.tiles import Box
from streamlod.core.train.field.decode import Splats, join
from streamlod.core.train.loss.region import loss_boxes

_ROOM_PIXELS = 4.0  # how far a Gaussian's edge may travel before its camera is planned anew
_WHOLE = 0.7  # share of dirty tiles from which the whole picture is planned


@dataclass(frozen=True, slots=True, eq=False)
class TileCache:
    """The part of one camera's picture that stays the same while a frame trains.

    Attributes:
        camera: whose picture.
        static: Gaussians that are drawn but not trained.
        background: [3] behind all of them.
        backend: of the rasteriser.
        backdrop: the static ones, ready to be drawn behind moving ones; on the CPU only.
        region: boxes of pixels that the loss needs, None for all.
        is_empty: whether no Gaussian that is trained can reach this picture.
    """

    camera: Camera
    static: Splats
    background: Tensor
    backend: Backend
    backdrop: Backdrop | None = None
    region: tuple[Box, ...] | None = None
    is_empty: bool = False

    def render(self, dynamic: Splats) -> tuple[Raster, TileCache]:
        """The picture with gradients for `dynamic`, and the cache to continue with: of more tiles if needed."""
        if self.backdrop is None:
            return self._render_whole(dynamic), self
        cache, raster = self, self._render_over(dynamic)
        if raster is None:
            cache = self._for_tiles(_room(self.camera, dynamic) | self.backdrop.stale)
            raster = cache._render_over(dynamic)
        if raster is None:  # what enters from far outside is projected a little differently when room is planned
            cache = self._for_tiles(np.ones_like(self.backdrop.stale))
            raster = cache._render_over(dynamic)
        assert raster is not None
        return raster, cache

    def _render_over(self, dynamic: Splats) -> Raster | None:
        assert self.backdrop is not None
        return rasterise_over(*dynamic.astuple(), backdrop=self.backdrop, background=self.background)

    def _render_whole(self, dynamic: Splats) -> Raster:
        parameters, rows = join(dynamic, self.static).astuple(), len(dynamic)
        return rasterise(
            *parameters, camera=self.camera, background=self.background, gradient_rows=rows, backend=self.backend
        )

    def _for_tiles(self, tile_mask: Bool) -> TileCache:
        """This cache, planned anew for other tiles."""
        assert self.backdrop is not None
        return _planned(self, tile_mask, self.backdrop.stale, self.backdrop.base)


def make_tile_cache(
    camera: Camera,
    dynamic: Splats,
    static: Splats,
    background: Tensor,
    backend: Backend,
    base: Tensor | None = None,
    before: Splats | None = None,
) -> TileCache:
    """Plan `camera`'s picture for `dynamic` Gaussians before `static` ones.

    Args:
        base: [H,W,3] the picture of both, where it is at hand; rendered otherwise.
        before: the dynamic ones as `base` shows them, where they have moved since.
    """
    cache = TileCache(camera, static, background, backend)
    if backend != "cpu":
        return cache
    if base is None:
        with torch.no_grad():
            base = cache.render(dynamic)[0].image
    stale = touched_tiles(camera, (dynamic if before is None else before).cloud())
    return _planned(cache, _room(camera, dynamic) | stale, stale, base.numpy())


def _planned(cache: TileCache, tile_mask: Bool, stale: Bool, base: Float32) -> TileCache:
    tile_mask = np.ones_like(tile_mask) if tile_mask.mean() > _WHOLE else tile_mask
    backdrop = prepare(cache.static.cloud(), cache.camera, tile_mask, stale, base)
    region = loss_boxes(tile_mask, cache.camera)
    return replace(cache, backdrop=backdrop, region=region, is_empty=not region)


def _room(camera: Camera, dynamic: Splats) -> Bool:
    return touched_tiles(camera, dynamic.cloud(), _ROOM_PIXELS)
