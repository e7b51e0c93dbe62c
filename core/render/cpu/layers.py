"""A backdrop whose still Gaussians are blended together wherever no moving one comes between them.

In most tiles a few moving Gaussians pass over a hundred still ones, which each training step would blend again. The
picture is that of blending all of them one by one, but that a pixel is finished a little later.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamlod.core.render.cpu.backdrop import Backdrop
from streamlod.core.render.cpu.dirty_tiles import NearDepths
from streamlod.core.render.cpu.kernels.inline.constants import RECORD, TILE_PIXELS
from streamlod.core.render.cpu.kernels.layers import blend_runs, count_runs
from streamlod.core.render.cpu.listing import share_tiles
from streamlod.core.render.tiles import tile_grid

MAX_LAYERS = 1 << 14  # of a camera, 64 MiB; a picture of 1280x720 has about 6,000
_LEAST = 6  # Gaussians that are worth a layer, which takes 4 KiB and the time of one that fills its tile


def layered(backdrop: Backdrop, near: NearDepths, most: int = MAX_LAYERS) -> Backdrop:
    """`backdrop` with layers, for moving Gaussians that stay in the order of depth in which they are now.

    Args:
        near: depths of the moving ones wherever they may come.
        most: layers; where there would be more, the backdrop stays as it is.
    """
    mask = backdrop.tile_mask.ravel()
    tiles, bounds = share_tiles(mask, np.diff(backdrop.offsets))
    lists = (backdrop.offsets, backdrop.lists, near.offsets, near.depths)
    layer_counts, entry_counts = np.zeros(len(mask), np.int64), np.zeros(len(mask), np.int64)
    count_runs(tiles, bounds, _LEAST, backdrop.depths, *lists, layer_counts, entry_counts)
    layer_offsets, offsets = (np.concatenate([[0], np.cumsum(counts)]) for counts in (layer_counts, entry_counts))
    count = int(layer_offsets[-1])
    if count > most:
        return backdrop
    layers, depths = np.empty((count, 4 * TILE_PIXELS), np.float32), np.empty(count, np.float32)
    entries, tiles_x = np.empty(int(offsets[-1]), np.int32), tile_grid(backdrop.camera.width, 1)[1]
    blend_runs(
        *(tiles, bounds, tiles_x, _LEAST, backdrop.records, backdrop.depths, *lists),
        *(layer_offsets, offsets, layers, depths, entries),
    )
    left = np.unique(entries[entries >= count]) - count  # still ones that are drawn one by one
    new_rank = np.zeros(count + len(backdrop.depths), np.int32)
    new_rank[:count] = np.arange(count)
    new_rank[count + left] = count + np.arange(len(left))
    return replace(
        backdrop,
        layers=layers,
        records=np.concatenate([np.zeros((count, RECORD), np.float32), backdrop.records[left]]),
        depths=np.concatenate([depths, backdrop.depths[left]]),
        offsets=offsets,
        lists=new_rank[entries],
    )
