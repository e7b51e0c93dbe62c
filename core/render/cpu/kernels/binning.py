"""Tile lists: for each tile, the depth ranks of the Gaussians that reach it, near to far.

A counting sort: every worker takes a slice of the depth order and counts its entries of each list; then it writes them
behind those of the workers before it. So lists are in depth order, whatever the number of workers, and nothing is
sorted by tile. Lists of still Gaussians, made once, and of moving ones, made at every step, are merged by depth.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from streamlod.core.arrays import Float32, Int32, Int64, UInt8
from streamlod.core.render.cpu.kernels.inline.constants import KERNEL, RECORD, SERIAL
from streamlod.core.render.cpu.kernels.inline.simd import prefetch
from streamlod.core.render.cpu.kernels.inline.tile import tile_span

_AHEAD = 16  # records between asking for one and using it


@njit(**SERIAL)
def _count_slice(
    start: int,
    stop: int,
    records: Float32,
    boxes: Int32,
    rows: Int32,
    sorted_records: Float32,
    sorted_boxes: Int32,
    tiles_x: int,
    tile_mask: UInt8,
    counts: Int64,
) -> None:
    """Copy ranks [start, stop) into depth order and count, for each tile, how many of them its list gets."""
    counts[:] = 0
    last = rows.shape[0] - 1
    for rank in range(start, stop):
        prefetch(records, np.int64(rows[min(rank + _AHEAD, last)]) * RECORD)
        row = rows[rank]
        record, box = sorted_records[rank], sorted_boxes[rank]
        for k in range(RECORD):
            record[k] = records[row, k]
        for k in range(4):
            box[k] = boxes[row, k]
        single = box[1] - box[0] == 1 or box[3] - box[2] == 1
        for tile_y in range(box[2], box[3]):
            left, right = tile_span(record, box[0], box[1], tile_y, single)
            for tile in range(tile_y * tiles_x + left, tile_y * tiles_x + right):
                counts[tile] += tile_mask[tile]


@njit(**SERIAL)
def _fill_slice(
    start: int,
    stop: int,
    sorted_records: Float32,
    sorted_boxes: Int32,
    tiles_x: int,
    tile_mask: UInt8,
    cursor: Int64,
    lists: Int32,
) -> None:
    """Append ranks [start, stop) to the lists, each at its tile's `cursor`, which moves on."""
    for rank in range(start, stop):
        record, box = sorted_records[rank], sorted_boxes[rank]
        single = box[1] - box[0] == 1 or box[3] - box[2] == 1
        for tile_y in range(box[2], box[3]):
            left, right = tile_span(record, box[0], box[1], tile_y, single)
            for tile in range(tile_y * tiles_x + left, tile_y * tiles_x + right):
                if tile_mask[tile]:
                    lists[cursor[tile]] = rank
                    cursor[tile] += 1


@njit(**KERNEL)
def count_pairs(
    workers: int,
    records: Float32,
    boxes: Int32,
    rows: Int32,
    sorted_records: Float32,
    sorted_boxes: Int32,
    tiles_x: int,
    tile_mask: UInt8,
    cursors: Int64,
    offsets: Int64,
) -> None:
    """Put records into depth order and find where each tile's list begins.

    Args:
        records [N,16], boxes [N,4]: from `project`. rows: [M] rows of the visible Gaussians, near to far.
        sorted_records [M,16], sorted_boxes [M,4]: out, in depth order.
        tile_mask: [T] 1 where a tile is wanted, 0 elsewhere.
        cursors: out, [workers,T] index into the lists at which each worker begins to write.
        offsets: out, [T+1] list t is [offsets[t], offsets[t+1]).
    """
    count = rows.shape[0]
    for w in prange(workers):
        start, stop = count * w // workers, count * (w + 1) // workers
        _count_slice(start, stop, records, boxes, rows, sorted_records, sorted_boxes, tiles_x, tile_mask, cursors[w])
    total = np.int64(0)
    for tile in range(tile_mask.shape[0]):
        offsets[tile] = total
        for w in range(workers):
            pairs = cursors[w, tile]
            cursors[w, tile] = total
            total += pairs
    offsets[tile_mask.shape[0]] = total


@njit(**KERNEL)
def fill_lists(
    workers: int,
    sorted_records: Float32,
    sorted_boxes: Int32,
    tiles_x: int,
    tile_mask: UInt8,
    cursors: Int64,
    lists: Int32,
) -> None:
    """Write the lists, [pairs] depth ranks, at the places that `count_pairs` found; overwrites `cursors`."""
    count = sorted_records.shape[0]
    for w in prange(workers):
        start, stop = count * w // workers, count * (w + 1) // workers
        _fill_slice(start, stop, sorted_records, sorted_boxes, tiles_x, tile_mask, cursors[w], lists)


@njit(**SERIAL)
def _merge_tile(
    front: Int32, front_depths: Float32, back: Int32, back_depths: Float32, shift: int, merged: Int32
) -> None:
    """Merge the lists `front` and `back` of one tile into `merged`; see `merge_lists`."""
    i, j = 0, 0
    for k in range(merged.shape[0]):
        if j == back.shape[0] or (i < front.shape[0] and front_depths[front[i]] <= back_depths[back[j]]):
            merged[k] = front[i] + shift
            i += 1
        else:
            merged[k] = back[j]
            j += 1


@njit(**KERNEL)
def merge_lists(
    tiles: Int32,
    bounds: Int64,
    front_offsets: Int64,
    front_lists: Int32,
    front_depths: Float32,
    back_offsets: Int64,
    back_lists: Int32,
    back_depths: Float32,
    shift: int,
    offsets: Int64,
    lists: Int32,
) -> None:
    """Merge two lists of each tile by depth; at equal depths those of the front come first.

    Args:
        tiles, bounds: tiles to do, and each worker's share of them, as for `blend_tiles`.
        front_offsets, front_lists, front_depths, and so for the back: lists of ranks, and the depth of each rank.
        shift: added to the ranks of the front.
        offsets: [T+1] where the merged lists begin. lists: out, [pairs].
    """
    for w in prange(bounds.shape[0] - 1):
        for t in range(bounds[w], bounds[w + 1]):
            tile = tiles[t]
            _merge_tile(
                front_lists[front_offsets[tile] : front_offsets[tile + 1]],
                front_depths,
                back_lists[back_offsets[tile] : back_offsets[tile + 1]],
                back_depths,
                shift,
                lists[offsets[tile] : offsets[tile + 1]],
            )
