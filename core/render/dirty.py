"""Dirty tiles: after the first frame, render only what moving Gaussians can change.

Once a frame and camera, `plan_dirty` finds the tiles that the dynamic Gaussians reach, with room to move, and the
static Gaussians that these tiles need. Every step then renders dynamic and gathered static ones with the plan's mask,
over a full picture made once; gradients are those of the full rendering. `covers` says when a Gaussian has left its
room.
numpy and numba only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numba
import numpy as np

from core.arrays import Bool, Float32, Int32, Int64
from core.camera import Camera
from core.gaussians import GaussianCloud
from core.render.cpu import POOL, contiguous
from core.render.cpu.frame import pack_camera
from core.render.cpu.kernels.dirty import find_touching, mark_tiles
from core.render.cpu.kernels.inline.constants import RECORD
from core.render.cpu.kernels.project import project
from core.render.cpu.workspace import Workspace
from core.render.tiles import TILE_HEIGHT, TILE_WIDTH, Box, tile_grid


@dataclass(frozen=True, slots=True, eq=False)
class DirtyPlan:
    """What to render of one camera's picture during one frame.

    Attributes:
        camera: the camera planned for.
        tile_mask: [tiles_y,tiles_x] bool, the tiles to render.
        static_rows: [S] int64 ascending rows of the static cloud that reach those tiles.
        box: the pixels of those tiles, or None when no tile is dirty. The loss's region.
    """

    camera: Camera
    tile_mask: Bool
    static_rows: Int64
    box: Box | None

    @property
    def share(self) -> float:
        """Part of the tiles that are dirty, 0 to 1."""
        return float(self.tile_mask.mean())

    def covers(self, dynamic: GaussianCloud) -> bool:
        """Whether the dynamic Gaussians, where they are now, touch no tile outside the plan."""
        return not (touched_tiles(self.camera, dynamic) & ~self.tile_mask).any()


def plan_dirty(
    camera: Camera, dynamic: GaussianCloud, static: GaussianCloud, dilation_pixels: float = 4.0
) -> DirtyPlan:
    """The plan for `dynamic` Gaussians before `static` ones.

    Args:
        dilation_pixels: how far a dynamic Gaussian's edge may travel before the plan is void.

    Raises:
        InputError: the camera has lens distortion.
    """
    mask = touched_tiles(camera, dynamic, dilation_pixels)
    return DirtyPlan(camera, mask, static_rows(camera, static, mask), _box(mask, camera))


def touched_tiles(camera: Camera, cloud: GaussianCloud, dilation_pixels: float = 0.0) -> Bool:
    """[tiles_y,tiles_x] bool: the tiles that Gaussians of `cloud` reach when each may move `dilation_pixels`."""
    # A wider picture, so that Gaussians which may enter from outside are projected too.
    padding = math.ceil(dilation_pixels)
    intrinsics = camera.intrinsics.copy()
    intrinsics[:2, 2] += padding
    width, height = camera.width + 2 * padding, camera.height + 2 * padding
    workspace = POOL.acquire()
    wider = replace(camera, intrinsics=intrinsics, width=width, height=height)
    records, _, depths = _project(workspace, wider, cloud)
    mask = np.zeros(tile_grid(camera.width, camera.height), np.uint8)
    mark_tiles(records, depths, np.float32(padding), np.float32(dilation_pixels), mask)
    POOL.release(workspace)
    return mask.astype(np.bool_)


def static_rows(camera: Camera, cloud: GaussianCloud, tile_mask: Bool) -> Int64:
    """[S] int64 ascending rows of the Gaussians of `cloud` that reach a tile of the mask."""
    workspace = POOL.acquire()
    records, boxes, depths = _project(workspace, camera, cloud)
    touching = np.zeros(len(cloud), np.uint8)
    find_touching(numba.get_num_threads(), records, boxes, depths, tile_mask.astype(np.uint8), touching)
    POOL.release(workspace)
    return np.flatnonzero(touching)


def _project(workspace: Workspace, camera: Camera, cloud: GaussianCloud) -> tuple[Float32, Int32, Float32]:
    cloud, count = contiguous(cloud), len(cloud)
    records = workspace.take("records", (count, RECORD), np.float32)
    boxes = workspace.take("boxes", (count, 4), np.int32)
    depths = workspace.take("depths", (count,), np.float32)
    parameters = (cloud.means, cloud.quaternions, cloud.scales, cloud.opacities, cloud.colours)
    size = (camera.width, camera.height)
    project(numba.get_num_threads(), *parameters, pack_camera(camera), *size, records, boxes, depths)
    return records, boxes, depths


def _box(mask: Bool, camera: Camera) -> Box | None:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return None
    right, bottom = (int(columns[-1]) + 1) * TILE_WIDTH, (int(rows[-1]) + 1) * TILE_HEIGHT
    left, top = int(columns[0]) * TILE_WIDTH, int(rows[0]) * TILE_HEIGHT
    return Box(left, top, min(right, camera.width), min(bottom, camera.height))
