"""One picture through the kernels: forward, and backward from what forward left in its workspace."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from core.arrays import Bool, Float32, Int32, Int64, UInt8
from core.camera import Camera
from core.errors import InputError, ModelError
from core.gaussians import GaussianCloud
from core.render.cpu.kernels.backward import differentiate_tiles
from core.render.cpu.kernels.binning import count_pairs, fill_lists
from core.render.cpu.kernels.forward import blend_tiles
from core.render.cpu.kernels.inline.constants import RECORD, SUMS
from core.render.cpu.kernels.project import project
from core.render.cpu.kernels.project_backward import differentiate_projection
from core.render.cpu.workspace import Workspace
from core.render.tiles import tile_grid

MAX_PAIRS = 1 << 27  # of a Gaussian and a tile: 512 MiB, seconds of work; sane scenes have a thousandth of it
_EMPTY_TILE = 64  # cost of a tile without Gaussians, in pairs, for sharing tiles out


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A rendered picture and what its backward pass needs; arrays belong to the workspace unless said otherwise.

    Attributes:
        image: [H,W,3] float32, own memory. transmittance: [H,W] float32, own memory.
        camera: [16] float32, see `pack_camera`.
        rows: [M] int32 ascending rows of the visible Gaussians, own memory.
        slots: [M] int32 depth rank -> index into `rows`.
        records: [N,16] by row; sorted_records: [M,16] by depth rank.
        tiles, bounds: tiles rendered, and each worker's share of them. offsets, lists: the tile lists.
    """

    image: Float32
    transmittance: Float32
    camera: Float32
    rows: Int32
    slots: Int32
    records: Float32
    sorted_records: Float32
    tiles: Int32
    bounds: Int64
    offsets: Int64
    lists: Int32


@dataclass(frozen=True, slots=True, eq=False)
class Gradients:
    """dL by each parameter, shapes as in GaussianCloud, zero where a Gaussian is not visible or wants none.

    Attributes:
        rows: [G] int32 visible rows among those that want gradients.
        screen: [G,2] dL by their projected means, in pixels.
    """

    means: Float32
    quaternions: Float32
    scales: Float32
    opacities: Float32
    colours: Float32
    rows: Int32
    screen: Float32


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


def forward(
    workspace: Workspace,
    cloud: GaussianCloud,
    camera: Camera,
    background: Float32,
    tile_mask: Bool | None = None,
    base: Float32 | None = None,
    most_pairs: int = MAX_PAIRS,
) -> Frame:
    """Render `cloud`.

    Args:
        background: [3] float32.
        tile_mask: [tiles_y,tiles_x] bool, tiles to render; all by default.
        base: [H,W,3] float32 pixels outside the mask; zeros by default.
        most_pairs: of a Gaussian and a tile.

    Raises:
        InputError: the camera has lens distortion.
        ModelError: the Gaussians are so large that their tile lists would not fit.
    """
    packed, width, height = pack_camera(camera), camera.width, camera.height
    count, workers = len(cloud), numba.get_num_threads()
    records = workspace.take("records", (count, RECORD), np.float32)
    boxes = workspace.take("boxes", (count, 4), np.int32)
    depths = workspace.take("depths", (count,), np.float32)
    parameters = (cloud.means, cloud.quaternions, cloud.scales, cloud.opacities, cloud.colours)
    project(workers, *parameters, packed, width, height, records, boxes, depths)

    rows = np.flatnonzero(depths > 0).astype(np.int32)
    slots = _depth_order(depths[rows])
    tiles_y, tiles_x = tile_grid(width, height)
    mask = np.ones(tiles_y * tiles_x, np.uint8) if tile_mask is None else tile_mask.astype(np.uint8).ravel()
    sorted_records = workspace.take("sorted_records", (len(rows), RECORD), np.float32)
    sorted_boxes = workspace.take("sorted_boxes", (len(rows), 4), np.int32)
    cursors = workspace.take("cursors", (workers, len(mask)), np.int64)
    offsets = workspace.take("offsets", (len(mask) + 1,), np.int64)
    order = rows[slots]
    count_pairs(workers, records, boxes, order, sorted_records, sorted_boxes, tiles_x, mask, cursors, offsets)
    pairs = int(offsets[-1])
    if pairs > most_pairs:
        fault = f"Gaussians cover {pairs} tiles together, more than {most_pairs}: their scales are out of hand"
        raise ModelError(fault)
    lists = workspace.take("lists", (pairs,), np.int32)
    fill_lists(workers, sorted_records, sorted_boxes, tiles_x, mask, cursors, lists)

    tiles, bounds = _share_tiles(mask, offsets, workers)
    if tile_mask is None:
        image, transmittance = np.empty((height, width, 3), np.float32), np.empty((height, width), np.float32)
    else:
        image = np.zeros((height, width, 3), np.float32) if base is None else base.copy()
        transmittance = np.ones((height, width), np.float32)
    blend_tiles(tiles, bounds, tiles_x, sorted_records, offsets, lists, background, image, transmittance)
    return Frame(image, transmittance, packed, rows, slots, records, sorted_records, tiles, bounds, offsets, lists)


def backward(
    workspace: Workspace,
    frame: Frame,
    cloud: GaussianCloud,
    image_gradient: Float32,
    light_gradient: Float32 | None = None,
    gradient_rows: int | None = None,
) -> Gradients:
    """Gradients of a loss, given its gradients by the picture.

    Args:
        image_gradient: [H,W,3] float32. light_gradient: [H,W] float32 by the transmittance; zero by default.
        gradient_rows: only the first rows of the cloud want gradients; all by default.
    """
    height, width = frame.transmittance.shape
    workers, count = len(frame.bounds) - 1, len(cloud)
    wanted = frame.rows if gradient_rows is None else frame.rows[: np.searchsorted(frame.rows, gradient_rows)]
    sums = workspace.take("sums", (workers, len(wanted), SUMS), np.float32)
    light = np.zeros((0, 0), np.float32) if light_gradient is None else light_gradient
    tiles_x = tile_grid(width, height)[1]
    out = Gradients(
        means=np.zeros((count, 3), np.float32),
        quaternions=np.zeros((count, 4), np.float32),
        scales=np.zeros((count, 3), np.float32),
        opacities=np.zeros(count, np.float32),
        colours=np.zeros((count, 3), np.float32),
        rows=wanted,
        screen=np.zeros((len(wanted), 2), np.float32),
    )
    if len(wanted):
        lists = (frame.sorted_records, frame.slots, frame.offsets, frame.lists)
        picture = (frame.image, frame.transmittance, image_gradient, light)
        differentiate_tiles(frame.tiles, frame.bounds, tiles_x, *lists, *picture, sums)
        parameters = (cloud.means, cloud.quaternions, cloud.scales, frame.camera, width, height)
        into = (out.means, out.quaternions, out.scales, out.opacities, out.colours, out.screen)
        differentiate_projection(workers, wanted, frame.records, sums, *parameters, *into)
    return out


def _depth_order(depths: Float32) -> Int32:
    """Indices from near to far, ties in order of index.

    Positive floats sort like their bits, so that one sort of 64-bit integers, depth above index, is stable and fast.
    """
    keys = (depths.view(np.uint32).astype(np.uint64) << np.uint64(32)) | np.arange(len(depths), dtype=np.uint64)
    keys.sort()
    return keys.astype(np.uint32).view(np.int32)


def _share_tiles(mask: UInt8, offsets: Int64, workers: int) -> tuple[Int32, Int64]:
    """Tiles to render, and where each worker's share begins: contiguous shares of about equal work."""
    tiles = np.flatnonzero(mask).astype(np.int32)
    work = np.cumsum(np.diff(offsets)[tiles] + _EMPTY_TILE)
    total = int(work[-1]) if len(work) else 0
    inner = np.searchsorted(work, total * np.arange(1, workers) / workers)
    return tiles, np.concatenate([[0], inner, [len(tiles)]]).astype(np.int64)
