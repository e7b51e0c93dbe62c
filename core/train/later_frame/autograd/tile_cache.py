"""Rendering one camera while one frame trains: on the CPU, only tiles that are trained are drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from streamlod.core.arrays import Bool
from streamlod.core.camera import Camera
from streamlod.core.render.backends import Backend
from streamlod.core.render.cpu.autograd import rasterise_over
from streamlod.core.render.cpu.backdrop import Backdrop, Canvas, canvas_of, prepare
from streamlod.core.render.cpu.dirty_tiles import near_depths, touched_tiles
from streamlod.core.render.cpu.layers import layered
from streamlod.core.render.differentiable import rasterise
from streamlod.core.render.raster import Raster
from streamlod.core.render.tiles import Box
from streamlod.core.train.field.decode import Splats, join
from streamlod.core.train.loss.region import loss_boxes

_ROOM_PIXELS = 4.0  # how far a Gaussian's edge may travel; what goes farther is not drawn there


@dataclass(frozen=True, slots=True, eq=False)
class TileCache:
    """The part of one camera's picture that stays the same while a frame trains.

    Attributes:
        camera: whose picture.
        static: Gaussians that are drawn but not trained.
        background: [3] behind all of them.
        backend: of the rasteriser.
        backdrop: the static ones, ready to be drawn behind moving ones; on the CPU only.
        layers: the same, blended together where no moving one is near, likewise.
        canvas: where the pictures of the steps are drawn, likewise.
        region: boxes of pixels that the loss needs, None for all.
        is_empty: whether no Gaussian that is trained can reach this picture.
    """

    camera: Camera
    static: Splats
    background: Tensor
    backend: Backend
    backdrop: Backdrop | None = None
    layers: Backdrop | None = None
    canvas: Canvas | None = None
    region: tuple[Box, ...] | None = None
    is_empty: bool = False

    def render(self, dynamic: Splats) -> Raster:
        """The picture with gradients for `dynamic`, until the next one is drawn; only tiles that can change are.

        Where one of them passes before or behind what is still, it may be drawn a little later than it gets there.
        """
        return self._render_over(self.layers, dynamic)

    def render_exactly(self, dynamic: Splats) -> Raster:
        """The same, each in its place by depth."""
        return self._render_over(self.backdrop, dynamic)

    def _render_over(self, backdrop: Backdrop | None, dynamic: Splats) -> Raster:
        if backdrop is not None and self.canvas is not None:
            return rasterise_over(*dynamic.astuple(), backdrop, self.background, self.canvas)
        return self._render_whole(dynamic)

    def render_two(self, first: Splats, second: Splats) -> tuple[Raster, Raster]:
        """Pictures with gradients for the same Gaussians in two places; on the CPU, only tiles where they differ."""
        if self.backdrop is None:
            return self._render_whole(first), self._render_whole(second)
        moved = torch.nonzero((first.means != second.means).any(dim=1))[:, 0]
        tiles = [touched_tiles(self.camera, one.rows(moved).cloud()) for one in (first, second)]
        over, canvases = (self.backdrop, self.background), (canvas_of(self.backdrop), canvas_of(self.backdrop))
        one, other = (
            rasterise_over(*splats.astuple(), *over, canvas, tiles[0] | tiles[1])
            for splats, canvas in zip((first, second), canvases, strict=True)
        )
        return one, other

    def _render_whole(self, dynamic: Splats) -> Raster:
        parameters, rows = join(dynamic, self.static).astuple(), len(dynamic)
        return rasterise(
            *parameters, camera=self.camera, background=self.background, gradient_rows=rows, backend=self.backend
        )


def make_tile_cache(
    camera: Camera,
    dynamic: Splats,
    static: Splats,
    background: Tensor,
    backend: Backend,
    active: Bool | None = None,
    base: Tensor | None = None,
) -> TileCache:
    """Plan `camera`'s picture for `dynamic` Gaussians before `static` ones.

    Args:
        active: [tiles_y,tiles_x] bool, tiles that are drawn beside those that `dynamic` reaches.
        base: [H,W,3] the picture of both, where it is at hand; rendered otherwise.
    """
    cache = TileCache(camera, static, background, backend)
    if backend != "cpu":
        return cache
    if base is None:
        with torch.no_grad():
            base = cache.render(dynamic).image
    near = near_depths(camera, dynamic.cloud(), _ROOM_PIXELS)
    tiles = near.tiles if active is None else near.tiles | active
    backdrop = prepare(static.cloud(), camera, tiles, base.numpy())
    return replace(
        cache,
        backdrop=backdrop,
        layers=layered(backdrop, near),
        canvas=canvas_of(backdrop),
        region=loss_boxes(tiles, camera),
        is_empty=not near.tiles.any(),
    )
