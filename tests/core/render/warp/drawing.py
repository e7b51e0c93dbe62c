"""Pushing clouds through the rasteriser in Warp, on the CPU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from streamlod.core.arrays import Float32
from streamlod.core.camera import Camera
from streamlod.core.render.warp.listing import (
    TileLists,
    camera_rows,
    cloud_room,
    grid_of,
    list_gaussians,
    listing,
)
from streamlod.core.render.warp.pictures import DrawnViews, Sight, differentiate, draw, pictures
from streamlod.core.scene.gaussians import GaussianCloud
from tests.core.render.scenes import NAMES

DEVICE = "cpu"
PAIRS = 1 << 14


def array(values: Any, dtype: Any) -> Any:
    """A Warp array of `values`."""
    return wp.array(np.ascontiguousarray(values), dtype=dtype, device=DEVICE)


def cloud_of(*clouds: GaussianCloud) -> Any:
    """The kernels' `Cloud` of as many views."""
    room = cloud_room(len(clouds), len(clouds[0].means), DEVICE)
    for name in NAMES:
        getattr(room, name).assign(np.stack([getattr(cloud, name) for cloud in clouds]))
    return room


@dataclass(frozen=True, eq=False)
class Drawing:
    """Moving Gaussians before still ones in all cameras; `draw` and `differentiate` it."""

    sight: Sight
    moving: TileLists
    still: TileLists
    out: DrawnViews
    count: Any
    cloud: Any
    by: Any

    def draw(self) -> Float32:
        """[V,H,W,3]."""
        s = self.sight
        list_gaussians(self.moving, self.count, self.cloud, s.chosen, s.cameras, s.grid, s.dirty, DEVICE)
        draw(self.moving, self.still, self.sight, self.out, DEVICE)
        return np.asarray(self.out.image.numpy())

    def gradients(self, by_image: Float32) -> dict[str, Float32]:
        """By name, of the views' clouds [D,G,...], of a loss with the gradient `by_image` [V,H,W,3]."""
        self.out.by_image.assign(by_image)
        differentiate(self.moving, self.still, self.sight, self.out, self.count, self.cloud, self.by, DEVICE)
        return {name: np.asarray(getattr(self.by, name).numpy()) for name in NAMES}


def drawing(
    moving: GaussianCloud | tuple[GaussianCloud, ...],
    cameras: tuple[Camera, ...],
    still: GaussianCloud | None = None,
    chosen: tuple[int, ...] | None = None,
    background: Float32 | None = None,
    dirty: Any = None,
    base: Any = None,
    pairs: int = PAIRS,
    **exposure: Float32,
) -> Drawing:
    """All tiles are dirty by default. `moving`: one for all views, or one a view."""
    clouds = (moving,) if isinstance(moving, GaussianCloud) else moving
    chosen = chosen or tuple(range(len(cameras)))
    width, height = cameras[0].width, cameras[0].height
    grid, count = grid_of(width, height), len(clouds[0].means)
    behind = None if background is None else np.tile(background, (len(cameras), 1))
    rows = array(camera_rows(cameras, behind=behind, **exposure), float)
    shown = np.ones((len(cameras), grid.tiles), np.int32) if dirty is None else dirty
    under = np.zeros((len(cameras), height, width, 3), np.float32) if base is None else base
    sight = Sight(grid, rows, array(np.array(chosen, np.int32), int), array(shown, int), array(under, wp.vec3))
    still_count = 0 if still is None else len(still.means)
    behind_layer = listing(len(cameras), max(still_count, 1), PAIRS, grid, DEVICE)
    if still is not None:
        every = array(np.arange(len(cameras), dtype=np.int32), int)
        nothing = wp.zeros((len(cameras), grid.tiles), dtype=int, device=DEVICE)
        number = array(np.array([still_count], np.int32), int)
        list_gaussians(behind_layer, number, cloud_of(still), every, rows, grid, nothing, DEVICE)
    return Drawing(
        sight,
        listing(len(chosen), count, pairs, grid, DEVICE),
        behind_layer,
        pictures(len(chosen), count, grid, DEVICE),
        array(np.array([count], np.int32), int),
        cloud_of(*clouds),
        cloud_room(len(clouds), count, DEVICE),
    )
