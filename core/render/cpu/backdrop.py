"""Rendering moving Gaussians over still ones: still ones are projected, sorted and listed once for many steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Bool, Float32, Int32, Int64
from streamlod.core.camera import Camera
from streamlod.core.render.cpu.frame import Frame, blend, contiguous
from streamlod.core.render.cpu.kernels.binning import merge_lists
from streamlod.core.render.cpu.listing import check_pairs, list_gaussians, pack_camera, projected, reaching, share_tiles
from streamlod.core.render.cpu.workspace import POOL, Workspace
from streamlod.core.scene.gaussians import GaussianCloud

_NO_GRADIENTS = np.iinfo(np.int32).max  # in place of an index: a Gaussian that wants no gradients


@dataclass(frozen=True, slots=True, eq=False)
class Backdrop:
    """The still Gaussians of one camera's picture, and what is already known of the picture.

    Attributes:
        camera: whose picture.
        tile_mask: [tiles_y,tiles_x] bool, tiles where the moving Gaussians may go.
        stale: [tiles_y,tiles_x] bool, tiles of `tile_mask` where `base` must not be trusted.
        base: [H,W,3] float32 the picture wherever nothing moves.
        records: [S,16] by depth rank, depths: [S] ascending, offsets: [T+1], lists: [pairs] depth ranks.
    """

    camera: Camera
    tile_mask: Bool
    stale: Bool
    base: Float32
    records: Float32
    depths: Float32
    offsets: Int64
    lists: Int32


def prepare(cloud: GaussianCloud, camera: Camera, tile_mask: Bool, stale: Bool, base: Float32) -> Backdrop:
    """`cloud` as a backdrop; see there for the other arguments.

    Raises:
        InputError: the camera has lens distortion.
        ModelError: the Gaussians are so large that their tile lists would not fit.
    """
    workspace = POOL.acquire()
    seen = projected(workspace, contiguous(cloud), camera)
    rows = reaching(seen, tile_mask)
    listing = list_gaussians(workspace, seen, rows, camera, tile_mask.astype(np.uint8).ravel())
    backdrop = Backdrop(
        camera=camera,
        tile_mask=tile_mask,
        stale=stale,
        base=base,
        records=listing.sorted_records.copy(),
        depths=seen.depths[rows[listing.order]],
        offsets=listing.offsets.copy(),
        lists=listing.lists.copy(),
    )
    POOL.release(workspace)
    return backdrop


def forward_over(workspace: Workspace, cloud: GaussianCloud, backdrop: Backdrop, background: Float32) -> Frame | None:
    """Render `cloud` together with the backdrop: the picture of `forward` for both, `cloud` first, bit by bit.

    Returns:
        None where a Gaussian of `cloud` reaches a tile outside the mask.

    Raises:
        ModelError: the Gaussians are so large that their tile lists would not fit.
    """
    camera, still = backdrop.camera, len(backdrop.records)
    seen = projected(workspace, cloud, camera)
    rows = np.flatnonzero(seen.depths > 0).astype(np.int32)
    everywhere = np.ones(backdrop.tile_mask.size, np.uint8)
    listing = list_gaussians(workspace, seen, rows, camera, everywhere, room=still)
    counts, mask = np.diff(listing.offsets), backdrop.tile_mask.ravel()
    reached = counts > 0
    if (reached & ~mask).any():
        return None
    drawn = reached | backdrop.stale.ravel()
    counts = np.where(drawn, counts + np.diff(backdrop.offsets), 0)
    offsets = workspace.take("merged_offsets", (len(counts) + 1,), np.int64)
    offsets[0] = 0
    np.cumsum(counts, out=offsets[1:])
    check_pairs(int(offsets[-1]))
    lists = workspace.take("merged_lists", (int(offsets[-1]),), np.int32)
    tiles, bounds = share_tiles(drawn, counts)
    front = (listing.offsets, listing.lists, seen.depths[rows[listing.order]])
    back = (backdrop.offsets, backdrop.lists, backdrop.depths)
    merge_lists(tiles, bounds, *front, *back, still, offsets, lists)
    listing.sorted_records[:still] = backdrop.records
    frame = Frame(
        image=backdrop.base.copy(),
        transmittance=np.ones((camera.height, camera.width), np.float32),
        camera=pack_camera(camera),
        visible=rows,
        rows=rows,
        order=np.concatenate([np.full(still, _NO_GRADIENTS, np.int32), listing.order]),
        records=listing.records,
        sorted_records=listing.sorted_records,
        tiles=tiles,
        bounds=bounds,
        offsets=offsets,
        lists=lists,
    )
    return blend(frame, background)
