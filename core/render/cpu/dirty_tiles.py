"""Dirty tiles: after the first frame, render only what moving Gaussians can change.

Once a frame and camera, `touched_tiles` finds where the moving Gaussians reach, with room to move;
`core.render.cpu.backdrop` lists the still ones there. Every step then draws the tiles that moving Gaussians reach now,
over a full picture made once; gradients are those of the full rendering. numpy and numba only.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numba
import numpy as np

from streamlod.core.arrays import Bool, Int32
from streamlod.core.camera import Camera
from streamlod.core.render.cpu.frame import contiguous
from streamlod.core.render.cpu.kernels.dirty import count_reached, mark_tiles
from streamlod.core.render.cpu.listing import projected
from streamlod.core.render.cpu.workspace import POOL
from streamlod.core.render.tiles import tile_grid
from streamlod.core.scene.gaussians import GaussianCloud


def touched_tiles(camera: Camera, cloud: GaussianCloud, dilation_pixels: float = 0.0) -> Bool:
    """[tiles_y,tiles_x] bool: the tiles that Gaussians of `cloud` reach when each may move `dilation_pixels`.

    Raises:
        InputError: the camera has lens distortion.
    """
    # A wider picture, so that Gaussians which may enter from outside are projected too.
    padding = math.ceil(dilation_pixels)
    intrinsics = camera.intrinsics.copy()
    intrinsics[:2, 2] += padding
    width, height = camera.width + 2 * padding, camera.height + 2 * padding
    workspace = POOL.acquire()
    wider = replace(camera, intrinsics=intrinsics, width=width, height=height)
    seen = projected(workspace, contiguous(cloud), wider)
    mask = np.zeros(tile_grid(camera.width, camera.height), np.uint8)
    mark_tiles(seen.records, seen.depths, np.float32(padding), np.float32(dilation_pixels), mask)
    POOL.release(workspace)
    return mask.astype(np.bool_)


def reached_tiles(camera: Camera, cloud: GaussianCloud, tiles: Bool) -> Int32:
    """[N,2] how many tiles each Gaussian of `cloud` reaches, and how many of `tiles` [tiles_y,tiles_x] among them.

    Raises:
        InputError: the camera has lens distortion.
    """
    workspace = POOL.acquire()
    seen = projected(workspace, contiguous(cloud), camera)
    counts = np.empty((len(cloud), 2), np.int32)
    count_reached(numba.get_num_threads(), seen.records, seen.boxes, seen.depths, tiles.astype(np.uint8), counts)
    POOL.release(workspace)
    return counts
