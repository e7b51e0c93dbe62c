"""Dirty tiles: after the first frame, render only what moving Gaussians can change.

Once a frame and camera, `near_depths` finds where the moving Gaussians reach, with room to move;
`core.render.cpu.backdrop` lists the still ones there. Every step then draws the tiles that moving Gaussians reach now,
over a full picture made once; gradients are those of the full rendering. numpy and numba only.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numba
import numpy as np

from streamlod.core.arrays import Bool, Float32, Int32, Int64
from streamlod.core.camera import Camera
from streamlod.core.render.cpu.frame import contiguous
from streamlod.core.render.cpu.kernels.dirty import count_near, count_reached, list_near
from streamlod.core.render.cpu.listing import Projected, check_pairs, projected
from streamlod.core.render.cpu.workspace import POOL
from streamlod.core.render.tiles import tile_grid
from streamlod.core.scene.gaussians import GaussianCloud


@dataclass(frozen=True, slots=True, eq=False)
class NearDepths:
    """Depths of the Gaussians that reach each tile when they may move a little.

    Attributes:
        tiles: [tiles_y,tiles_x] bool, where there are any.
        offsets: [T+1], depths: ascending in each tile; tile t has depths[offsets[t]:offsets[t+1]].
    """

    tiles: Bool
    offsets: Int64
    depths: Float32


def touched_tiles(camera: Camera, cloud: GaussianCloud, dilation_pixels: float = 0.0) -> Bool:
    """[tiles_y,tiles_x] bool: the tiles that Gaussians of `cloud` reach when each may move `dilation_pixels`.

    Raises:
        InputError: the camera has lens distortion.
    """
    counts = np.zeros(tile_grid(camera.width, camera.height), np.int64)
    with _padded(camera, cloud, dilation_pixels) as (seen, padding):
        count_near(seen.records, seen.depths, padding, np.float32(dilation_pixels), counts)
    return counts > 0


def near_depths(camera: Camera, cloud: GaussianCloud, dilation_pixels: float) -> NearDepths:
    """Depths of the Gaussians of `cloud` in the tiles that they reach when each may move `dilation_pixels`.

    Raises:
        InputError: the camera has lens distortion.
    """
    counts, dilation = np.zeros(tile_grid(camera.width, camera.height), np.int64), np.float32(dilation_pixels)
    with _padded(camera, cloud, dilation_pixels) as (seen, padding):
        count_near(seen.records, seen.depths, padding, dilation, counts)
        offsets = np.concatenate([[0], np.cumsum(counts.ravel())])
        check_pairs(int(offsets[-1]))
        depths, cursors = np.empty(int(offsets[-1]), np.float32), offsets[:-1].reshape(counts.shape).copy()
        visible = np.flatnonzero(seen.depths > 0)
        order = visible[np.argsort(seen.depths[visible], kind="stable")]
        list_near(seen.records, seen.depths, order, padding, dilation, cursors, depths)
    return NearDepths(counts > 0, offsets, depths)


@contextmanager
def _padded(camera: Camera, cloud: GaussianCloud, dilation_pixels: float) -> Iterator[tuple[Projected, np.float32]]:
    """`cloud` in a wider picture, so that what may enter from outside is projected too, and how much wider."""
    padding = math.ceil(dilation_pixels)
    intrinsics = camera.intrinsics.copy()
    intrinsics[:2, 2] += padding
    width, height = camera.width + 2 * padding, camera.height + 2 * padding
    workspace = POOL.acquire()
    wider = replace(camera, intrinsics=intrinsics, width=width, height=height)
    yield projected(workspace, contiguous(cloud), wider), np.float32(padding)
    POOL.release(workspace)


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
