"""Rendering moving Gaussians over still ones: still ones are projected, sorted and listed once for many steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Bool, Float32, Int32, Int64
from streamlod.core.camera import Camera
from streamlod.core.render.cpu.frame import Frame, blend, contiguous
from streamlod.core.render.cpu.kernels.binning import merge_lists
from streamlod.core.render.cpu.kernels.inline.constants import TILE_PIXELS
from streamlod.core.render.cpu.listing import check_pairs, list_gaussians, pack_camera, projected, reaching, share_tiles
from streamlod.core.render.cpu.workspace import POOL, Workspace
from streamlod.core.scene.gaussians import GaussianCloud

_NO_GRADIENTS = np.iinfo(np.int32).max  # in place of an index: a Gaussian that wants no gradients


@dataclass(frozen=True, slots=True, eq=False)
class Backdrop:
    """The still Gaussians of one camera's picture, and what is already known of the picture.

    Attributes:
        camera: whose picture.
        tile_mask: [tiles_y,tiles_x] bool, tiles that are drawn.
        base: [H,W,3] float32 the picture in all other tiles.
        layers: [L,1024] runs of still Gaussians that are blended already (`core.render.cpu.kernels.layers`).
        records: [S,16] by rank, of which the first L stand for layers; depths: [S]. offsets: [T+1], lists: [pairs]
            ranks, near to far in each tile.
    """

    camera: Camera
    tile_mask: Bool
    base: Float32
    layers: Float32
    records: Float32
    depths: Float32
    offsets: Int64
    lists: Int32


def prepare(cloud: GaussianCloud, camera: Camera, tile_mask: Bool, base: Float32) -> Backdrop:
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
        base=base,
        layers=np.empty((0, 4 * TILE_PIXELS), np.float32),
        records=listing.sorted_records.copy(),
        depths=seen.depths[rows[listing.order]],
        offsets=listing.offsets.copy(),
        lists=listing.lists.copy(),
    )
    POOL.release(workspace)
    return backdrop


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """Memory to draw one camera's pictures in, one after another: image [H,W,3] and transmittance [H,W]."""

    image: Float32
    transmittance: Float32


def canvas_of(backdrop: Backdrop) -> Canvas:
    """A canvas on which all is drawn but the tiles of the mask."""
    return Canvas(backdrop.base.copy(), np.ones(backdrop.base.shape[:2], np.float32))


def forward_over(
    workspace: Workspace,
    cloud: GaussianCloud,
    backdrop: Backdrop,
    background: Float32,
    canvas: Canvas,
    tiles: Bool | None = None,
) -> Frame:
    """Render `cloud` together with the backdrop: the picture of `forward` for both, `cloud` first, bit by bit.

    Other tiles stay as they are on the `canvas`, whatever of `cloud` reaches them.

    Args:
        tiles: [tiles_y,tiles_x] bool, those of the backdrop's mask to draw; all of them by default.

    Raises:
        ModelError: the Gaussians are so large that their tile lists would not fit.
    """
    camera, still = backdrop.camera, len(backdrop.records)
    wanted = backdrop.tile_mask if tiles is None else tiles & backdrop.tile_mask
    mask = wanted.ravel()
    seen = projected(workspace, cloud, camera)
    rows = reaching(seen, wanted)
    listing = list_gaussians(workspace, seen, rows, camera, mask.astype(np.uint8), room=still)
    offsets = workspace.take("merged_offsets", listing.offsets.shape, np.int64)
    counts = np.where(mask, np.diff(listing.offsets) + np.diff(backdrop.offsets), 0)
    offsets[0] = 0
    np.cumsum(counts, out=offsets[1:])
    check_pairs(int(offsets[-1]))
    lists = workspace.take("merged_lists", (int(offsets[-1]),), np.int32)
    numbers, bounds = share_tiles(mask, counts)
    front = (listing.offsets, listing.lists, seen.depths[rows[listing.order]])
    back = (backdrop.offsets, backdrop.lists, backdrop.depths)
    merge_lists(numbers, bounds, *front, *back, still, offsets, lists)
    listing.sorted_records[:still] = backdrop.records
    frame = Frame(
        image=canvas.image,
        transmittance=canvas.transmittance,
        camera=pack_camera(camera),
        layers=backdrop.layers,
        visible=rows,
        rows=rows,
        order=np.concatenate([np.full(still, _NO_GRADIENTS, np.int32), listing.order]),
        records=listing.records,
        sorted_records=listing.sorted_records,
        tiles=numbers,
        bounds=bounds,
        offsets=offsets,
        lists=lists,
    )
    return blend(frame, background)
