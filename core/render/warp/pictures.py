"""Pictures of moving Gaussians before still ones, and the gradients of the moving ones: all views in one pass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from streamlod.core.render.tiles import TILE_HEIGHT, TILE_WIDTH
from streamlod.core.render.warp.kernels.blend import blend
from streamlod.core.render.warp.kernels.blend_adjoint import differentiate_blend
from streamlod.core.render.warp.kernels.project_adjoint import differentiate_projection
from streamlod.core.render.warp.listing import TileLists

_PIXELS = TILE_WIDTH * TILE_HEIGHT


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """The settings that views are drawn with.

    Attributes:
        grid: of their pictures. cameras: [C,25] rows of `listing.camera_rows`.
        chosen: [V] int32 camera of each view.
        dirty: [C,tiles] int32, nonzero for tiles to draw. base: [C,H,W] pictures that the others show.
    """

    grid: Any
    cameras: Any
    chosen: Any
    dirty: Any
    base: Any


@dataclass(frozen=True, slots=True, eq=False)
class DrawnViews:
    """Parts of V views.

    Attributes:
        image: [V,H,W] vec3. light: [V,H,W] what of the background shows.
        by_image: [V,H,W] vec3 the loss's gradient. by_light: likewise, or empty where it is zero. sums: [V,G,9].
    """

    image: Any
    light: Any
    by_image: Any
    by_light: Any
    sums: Any


def pictures(views: int, gaussians: int, grid: Any, device: str) -> DrawnViews:
    """Room for pictures, and for the gradients of so many Gaussians."""
    shape = (views, grid.height, grid.width)
    return DrawnViews(
        wp.zeros(shape, dtype=wp.vec3, device=device),
        wp.zeros(shape, dtype=float, device=device),
        wp.zeros(shape, dtype=wp.vec3, device=device),
        wp.zeros((0, 0, 0), dtype=float, device=device),
        wp.zeros((views, gaussians, 9), dtype=float, device=device),
    )


def draw(moving: TileLists, still: TileLists, sight: Sight, out: DrawnViews, device: str) -> None:
    """Blend both layers into `out.image` and `out.light`."""
    given = [moving.layer, still.layer, sight.chosen, sight.cameras, sight.grid, sight.dirty, sight.base]
    blocks = (sight.chosen.shape[0] * sight.grid.tiles, _PIXELS)
    wp.launch(blend, dim=blocks, inputs=[*given, out.image, out.light], block_dim=_PIXELS, device=device)


def differentiate(
    moving: TileLists, still: TileLists, sight: Sight, out: DrawnViews, count: Any, cloud: Any, by: Any, device: str
) -> None:
    """From `out.by_image` to the gradients `by` of the moving Gaussians, which `cloud` holds."""
    out.sums.zero_()
    given = [moving.layer, still.layer, sight.chosen, sight.grid]
    given += [out.image, out.light, out.by_image, out.by_light, out.sums]
    blocks = (sight.chosen.shape[0] * sight.grid.tiles, _PIXELS)
    wp.launch(differentiate_blend, dim=blocks, inputs=given, block_dim=_PIXELS, device=device)
    projected = [count, cloud, sight.chosen, sight.cameras, sight.grid, moving.layer, out.sums, by]
    wp.launch(differentiate_projection, dim=cloud.means.shape, inputs=projected, device=device)
