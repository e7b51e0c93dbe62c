"""Gaussians listed by view, tile and depth, in memory of a fixed size.

Nothing here waits for the device or takes memory while listing, so that all of it can be recorded as a graph. What has
no room is left out, and `TileLists.overflow` tells afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from streamlod.core.arrays import Float32
from streamlod.core.camera import Camera
from streamlod.core.render.tiles import tile_grid
from streamlod.core.render.warp.kernels.clear import clear_list
from streamlod.core.render.warp.kernels.project import find_ranges, project
from streamlod.core.render.warp.kernels.rules import CAMERA_NUMBERS, Cloud, Layer, TileGrid


@dataclass(frozen=True, slots=True, eq=False)
class TileLists:
    """Projected Gaussians of some views and their lists.

    Attributes:
        layer: what is drawn.
        keys: [2*pairs] uint64 view, tile and depth of each pair of Gaussian and tile; half of it work memory.
        wanted: [1] int64 pairs that there were at last; most: [1] the largest number before.
        pairs: capacity.
    """

    layer: Any
    keys: Any
    wanted: Any
    most: Any
    pairs: int

    @property
    def largest(self) -> int:
        """The most pairs that there were so far, with those that had no room; waits for the device."""
        return max(int(count.numpy()[0]) for count in (self.wanted, self.most))

    @property
    def overflow(self) -> int:
        """Pairs by which the capacity was exceeded at most so far, 0 where all had room; waits for the device."""
        return max(self.largest - self.pairs, 0)


def grid_of(width: int, height: int) -> Any:
    """The tiles of pictures of that size, for kernels."""
    rows, columns = tile_grid(width, height)
    grid = TileGrid()
    grid.width, grid.height, grid.tiles_x, grid.tiles = width, height, columns, rows * columns
    return grid


def listing(views: int, gaussians: int, pairs: int, grid: Any, device: str) -> TileLists:
    """Room for the Gaussians of `views` pictures and for their `pairs` of Gaussian and tile."""
    layer = Layer()
    layer.place = wp.zeros((views, gaussians), dtype=wp.vec4, device=device)
    layer.conic = wp.zeros((views, gaussians), dtype=wp.vec4, device=device)
    layer.colour = wp.zeros((views, gaussians), dtype=wp.vec3, device=device)
    layer.first = wp.zeros(views * grid.tiles, dtype=int, device=device)
    layer.last = wp.zeros(views * grid.tiles, dtype=int, device=device)
    layer.ids = wp.zeros(2 * pairs, dtype=int, device=device)
    keys = wp.zeros(2 * pairs, dtype=wp.uint64, device=device)
    wanted, most = (wp.zeros(1, dtype=wp.int64, device=device) for _ in range(2))
    return TileLists(layer, keys, wanted, most, pairs)


def list_gaussians(
    room: TileLists, count: Any, cloud: Any, chosen: Any, cameras: Any, grid: Any, dirty: Any, device: str
) -> None:
    """Project and list the first `count` [1] Gaussians of `cloud` for the cameras `chosen` [V]; see `project`."""
    layer, (views, gaussians) = room.layer, room.layer.place.shape
    ranges = layer.first.shape[0]
    cleared = [room.keys, layer, room.wanted, room.most, room.pairs]
    wp.launch(clear_list, dim=max(room.pairs, ranges), inputs=cleared, device=device)
    given = [count, cloud, chosen, cameras, grid, layer, room.keys, room.wanted, dirty]
    wp.launch(project, dim=(views, gaussians), inputs=given, device=device)
    wp.utils.radix_sort_pairs(room.keys, layer.ids, room.pairs, 0, 32 + ranges.bit_length())
    wp.launch(find_ranges, dim=room.pairs, inputs=[room.keys, layer], device=device)


def camera_rows(
    cameras: Sequence[Camera], gain: Float32 | None = None, offset: Float32 | None = None, behind: Float32 | None = None
) -> Float32:
    """[C,25] what kernels know of cameras (`kernels.rules`).

    Args:
        gain, offset: [C,3] exposure of the Gaussians' colours; neutral by default.
        behind: [C,3] background, exposed; black by default.
    """
    rows = np.zeros((len(cameras), CAMERA_NUMBERS), np.float32)
    for row, camera in zip(rows, cameras, strict=True):
        row[:9], row[9:12] = camera.world_to_camera[:3, :3].ravel(), camera.world_to_camera[:3, 3]
        k = camera.intrinsics
        row[12:16] = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
    rows[:, 16:19] = 1 if gain is None else gain
    rows[:, 19:22] = 0 if offset is None else offset
    rows[:, 22:25] = 0 if behind is None else behind
    return rows


def cloud_room(views: int, gaussians: int, device: str) -> Any:
    """A `Cloud` of zeros: for each of `views` its own Gaussians, or for all the same where that is 1."""
    shape, cloud = (views, gaussians), Cloud()
    cloud.means = wp.zeros(shape, dtype=wp.vec3, device=device)
    cloud.quaternions = wp.zeros(shape, dtype=wp.vec4, device=device)
    cloud.scales = wp.zeros(shape, dtype=wp.vec3, device=device)
    cloud.opacities = wp.zeros(shape, dtype=float, device=device)
    cloud.colours = wp.zeros(shape, dtype=wp.vec3, device=device)
    return cloud
