"""Dirty tiles: after the first frame, render only what moving Gaussians can change.

Once a frame and camera, `touched_tiles` finds where the moving Gaussians reach, with room to move;
`core.render.cpu.backdrop` lists the still ones there. Every step then draws the tiles that moving Gaussians reach now,
over a full picture made once; gradients are those of the full rendering. numpy and numba only.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from core.arrays import Bool, Int32
from core.camera import Camera
from core.gaussians import GaussianCloud
from core.render.cpu import POOL, contiguous
from core.render.cpu.kernels.dirty import mark_tiles
from core.render.cpu.listing import projected, reaching
from core.render.tiles import TILE_HEIGHT, TILE_WIDTH, Box, tile_grid


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


def reaching_rows(camera: Camera, cloud: GaussianCloud, tile_mask: Bool) -> tuple[Int32, Int32]:
    """Ascending rows of the Gaussians of `cloud` in view, and of those that reach a tile of `tile_mask`."""
    workspace = POOL.acquire()
    seen = projected(workspace, contiguous(cloud), camera)
    found = np.flatnonzero(seen.depths > 0).astype(np.int32), reaching(seen, tile_mask)
    POOL.release(workspace)
    return found


def tiles_of(pixels: Bool) -> Bool:
    """[tiles_y,tiles_x] bool: the tiles with a pixel of `pixels` [H,W]."""
    rows, columns = tile_grid(pixels.shape[1], pixels.shape[0])
    padded = np.zeros((rows * TILE_HEIGHT, columns * TILE_WIDTH), np.bool_)
    padded[: pixels.shape[0], : pixels.shape[1]] = pixels
    return np.asarray(padded.reshape(rows, TILE_HEIGHT, columns, TILE_WIDTH).any(axis=(1, 3)))


def bounding_box(tile_mask: Bool, camera: Camera) -> Box | None:
    """The least box of pixels that holds all tiles of the mask; None where there are none."""
    rows, columns = np.flatnonzero(tile_mask.any(axis=1)), np.flatnonzero(tile_mask.any(axis=0))
    if len(rows) == 0:
        return None
    right, bottom = (int(columns[-1]) + 1) * TILE_WIDTH, (int(rows[-1]) + 1) * TILE_HEIGHT
    left, top = int(columns[0]) * TILE_WIDTH, int(rows[0]) * TILE_HEIGHT
    return Box(left, top, min(right, camera.width), min(bottom, camera.height))
