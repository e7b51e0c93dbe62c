"""Which Gaussians each tile draws, near to far: projected, sorted by depth, and listed."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from streamlod.core.arrays import Bool, Float32, Int32, Int64, UInt8
from streamlod.core.camera import Camera
from streamlod.core.errors import InputError, ModelError
from streamlod.core.render.cpu.kernels.binning import count_pairs, fill_lists
from streamlod.core.render.cpu.kernels.dirty import find_touching
from streamlod.core.render.cpu.kernels.inline.constants import RECORD
from streamlod.core.render.cpu.kernels.project import project
from streamlod.core.render.cpu.workspace import Workspace
from streamlod.core.render.tiles import tile_grid
from streamlod.core.scene.gaussians import GaussianCloud

MAX_PAIRS = 1 << 27  # of a Gaussian and a tile: 512 MiB, seconds of work; sane scenes have a thousandth of it
_EMPTY_TILE = 64  # cost of a tile without Gaussians, in pairs, for sharing tiles out


@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """N Gaussians in the picture: records [N,16], boxes [N,4] of tiles, depths [N], 0 where invisible."""

    records: Float32
    boxes: Int32
    depths: Float32


@dataclass(frozen=True, slots=True, eq=False)
class Listing:
    """The lists of all tiles; arrays belong to the workspace unless said otherwise.

    Attributes:
        rows: [M] int32 ascending rows of the Gaussians that may be drawn, own memory.
        order: [M] int32 depth rank -> index into `rows`, own memory.
        records: [N,16] by row. sorted_records: [room+M,16] by depth rank, behind `room` free ones.
        offsets: [T+1], lists: [pairs] depth ranks; tile t has lists[offsets[t]:offsets[t+1]].
    """

    rows: Int32
    order: Int32
    records: Float32
    sorted_records: Float32
    offsets: Int64
    lists: Int32


def pack_camera(camera: Camera) -> Float32:
    """[16] float32: rotation row by row, translation, fx fy cx cy.

    Raises:
        InputError: the camera has lens distortion, which splatting cannot follow.
    """
    if camera.has_distortion:
        raise InputError(f"camera {camera.name}", "has lens distortion; undistort its pictures and use undistorted()")
    pose, k = camera.world_to_camera, camera.intrinsics
    focal = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
    return np.concatenate([pose[:3, :3].ravel(), pose[:3, 3], focal]).astype(np.float32)


def projected(workspace: Workspace, cloud: GaussianCloud, camera: Camera) -> Projected:
    """`cloud`, whose arrays must be C-contiguous, as `camera` sees it; arrays belong to the workspace."""
    count = len(cloud)
    records = workspace.take("records", (count, RECORD), np.float32)
    boxes = workspace.take("boxes", (count, 4), np.int32)
    depths = workspace.take("depths", (count,), np.float32)
    parameters = (cloud.means, cloud.quaternions, cloud.scales, cloud.opacities, cloud.colours)
    size = (camera.width, camera.height)
    project(numba.get_num_threads(), *parameters, pack_camera(camera), *size, records, boxes, depths)
    return Projected(records, boxes, depths)


def reaching(seen: Projected, tile_mask: Bool) -> Int32:
    """[S] int32 ascending rows of the Gaussians that reach a tile of `tile_mask` [tiles_y,tiles_x]."""
    if tile_mask.all():
        return np.flatnonzero(seen.depths > 0).astype(np.int32)
    touching, mask = np.zeros(len(seen.depths), np.uint8), tile_mask.astype(np.uint8)
    find_touching(numba.get_num_threads(), seen.records, seen.boxes, seen.depths, mask, touching)
    return np.flatnonzero(touching).astype(np.int32)


def list_gaussians(
    workspace: Workspace,
    seen: Projected,
    rows: Int32,
    camera: Camera,
    mask: UInt8,
    *,
    room: int = 0,
    most_pairs: int = MAX_PAIRS,
) -> Listing:
    """Lists of the Gaussians `rows` (ascending, in view) for the tiles of `mask` [T].

    Args:
        room: free rows before the first of `sorted_records`.
        most_pairs: of a Gaussian and a tile.

    Raises:
        ModelError: the Gaussians are so large that their lists would not fit.
    """
    workers, tiles_x = numba.get_num_threads(), tile_grid(camera.width, camera.height)[1]
    order = _depth_order(seen.depths[rows])
    sorted_records = workspace.take("sorted_records", (room + len(rows), RECORD), np.float32)
    sorted_boxes = workspace.take("sorted_boxes", (len(rows), 4), np.int32)
    cursors = workspace.take("cursors", (workers, len(mask)), np.int64)
    offsets = workspace.take("offsets", (len(mask) + 1,), np.int64)
    own = sorted_records[room:]
    count_pairs(workers, seen.records, seen.boxes, rows[order], own, sorted_boxes, tiles_x, mask, cursors, offsets)
    pairs = int(offsets[-1])
    check_pairs(pairs, most_pairs)
    lists = workspace.take("lists", (pairs,), np.int32)
    fill_lists(workers, own, sorted_boxes, tiles_x, mask, cursors, lists)
    return Listing(rows, order, seen.records, sorted_records, offsets, lists)


def check_pairs(pairs: int, most: int = MAX_PAIRS) -> None:
    """Refuse lists that would not fit.

    Raises:
        ModelError: there are more pairs than `most`.
    """
    if pairs > most:
        raise ModelError(f"Gaussians cover {pairs} tiles together, more than {most}: their scales are out of hand")


def share_tiles(mask: UInt8 | Bool, counts: Int64) -> tuple[Int32, Int64]:
    """Tiles to render, and where each worker's share begins: contiguous shares of about equal work.

    Args:
        mask: [T] tiles wanted. counts: [T] Gaussians of each.
    """
    workers = numba.get_num_threads()
    tiles = np.flatnonzero(mask).astype(np.int32)
    work = np.cumsum(counts[tiles] + _EMPTY_TILE)
    total = int(work[-1]) if len(work) else 0
    inner = np.searchsorted(work, total * np.arange(1, workers) / workers)
    return tiles, np.concatenate([[0], inner, [len(tiles)]]).astype(np.int64)


def _depth_order(depths: Float32) -> Int32:
    """Indices from near to far, ties in order of index.

    Positive floats sort like their bits, so that one sort of 64-bit integers, depth above index, is stable and fast.
    """
    keys = (depths.view(np.uint32).astype(np.uint64) << np.uint64(32)) | np.arange(len(depths), dtype=np.uint64)
    keys.sort()
    return keys.astype(np.uint32).view(np.int32)
