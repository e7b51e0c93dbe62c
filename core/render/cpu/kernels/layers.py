"""Still Gaussians between moving ones, blended once into layers.

Blending is associative: neighbours in a tile's list come to one colour and one transmittance a pixel, which later
pictures can blend in their place. A layer is a row of 1024 floats: planes of transmittance, red, green and blue of a
tile, colours times opacity. A run is a part of a list that no moving Gaussian parts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange

from streamlod.core.arrays import Float32, Int32, Int64
from streamlod.core.render.cpu.kernels.forward import blend_gaussian
from streamlod.core.render.cpu.kernels.inline.constants import (
    HALF,
    INLINE,
    KERNEL,
    MEAN_X,
    MEAN_Y,
    ONE,
    SERIAL,
    TILE_HEIGHT,
    TILE_PIXELS,
    TILE_WIDTH,
    ZERO,
)


@njit(**INLINE)
def _end_of_run(ranks: Int32, first: int, depths: Float32, near: Float32, at: int) -> Any:
    """End of the run of `ranks` from `first` on, and how many of the depths `near`, `at` or more, lie before it."""
    while at < near.shape[0] and near[at] <= depths[ranks[first]]:
        at += 1
    end = first + 1
    while end < ranks.shape[0] and (at == near.shape[0] or depths[ranks[end]] < near[at]):
        end += 1
    return end, at


@njit(**KERNEL)
def count_runs(
    tiles: Int32,
    bounds: Int64,
    least: int,
    depths: Float32,
    offsets: Int64,
    lists: Int32,
    near_offsets: Int64,
    near_depths: Float32,
    layer_counts: Int64,
    entry_counts: Int64,
) -> None:
    """Count what lists come to when runs of `least` Gaussians and more become layers.

    Args:
        tiles, bounds: as for `blend_tiles`.
        depths [S] by rank, offsets [T+1], lists [pairs]: of the still ones. near_offsets [T+1], near_depths: of
            moving ones, ascending in each tile.
        layer_counts, entry_counts: [T] out, layers of a tile, and entries of its list with them.
    """
    for w in prange(bounds.shape[0] - 1):
        for t in range(bounds[w], bounds[w + 1]):
            tile = tiles[t]
            ranks = lists[offsets[tile] : offsets[tile + 1]]
            near = near_depths[near_offsets[tile] : near_offsets[tile + 1]]
            first, at, layers, entries = 0, 0, 0, 0
            while first < ranks.shape[0]:
                end, at = _end_of_run(ranks, first, depths, near, at)
                if end - first >= least:
                    layers += 1
                    entries += 1
                else:
                    entries += end - first
                first = end
            layer_counts[tile], entry_counts[tile] = layers, entries


@njit(**SERIAL)
def _blend_run(tile: int, tiles_x: int, ranks: Int32, records: Float32, layer: Float32) -> None:
    """Blend the Gaussians `ranks` of a tile into `layer` [1024]."""
    tile_y = tile // tiles_x
    x0, y0 = np.float32((tile - tile_y * tiles_x) * TILE_WIDTH) + HALF, np.float32(tile_y * TILE_HEIGHT) + HALF
    layer[:TILE_PIXELS] = ONE
    layer[TILE_PIXELS:] = ZERO
    for rank in ranks:
        record = records[rank]
        blend_gaussian(layer, record, record[MEAN_X] - x0, record[MEAN_Y] - y0, TILE_HEIGHT)
    for p in range(TILE_PIXELS):
        layer[p] = abs(layer[p])


@njit(**KERNEL)
def blend_runs(
    tiles: Int32,
    bounds: Int64,
    tiles_x: int,
    least: int,
    records: Float32,
    depths: Float32,
    offsets: Int64,
    lists: Int32,
    near_offsets: Int64,
    near_depths: Float32,
    layer_offsets: Int64,
    entry_offsets: Int64,
    layers: Float32,
    layer_depths: Float32,
    entries: Int32,
) -> None:
    """Blend the runs that `count_runs` counts, and list what is left; arguments as there.

    Args:
        records: [S,16] by rank. layer_offsets, entry_offsets: [T+1] where those of each tile begin.
        layers: [L,1024] out. layer_depths: [L] out, depth of each run's middle.
        entries: out, the lists: numbers of layers, and ranks after them.
    """
    room = layers.shape[0]
    for w in prange(bounds.shape[0] - 1):
        for t in range(bounds[w], bounds[w + 1]):
            tile = tiles[t]
            ranks = lists[offsets[tile] : offsets[tile + 1]]
            near = near_depths[near_offsets[tile] : near_offsets[tile + 1]]
            first, at, layer, entry = 0, 0, layer_offsets[tile], entry_offsets[tile]
            while first < ranks.shape[0]:
                end, at = _end_of_run(ranks, first, depths, near, at)
                if end - first >= least:
                    _blend_run(tile, tiles_x, ranks[first:end], records, layers[layer])
                    layer_depths[layer] = depths[ranks[(first + end) // 2]]
                    entries[entry] = layer
                    layer += 1
                    entry += 1
                else:
                    for k in range(first, end):
                        entries[entry] = ranks[k] + room
                        entry += 1
                first = end
