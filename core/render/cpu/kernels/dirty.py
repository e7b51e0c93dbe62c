"""Which tiles Gaussians touch, and which Gaussians touch given tiles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, prange

from streamlod.core.arrays import Float32, Int32, Int64, UInt8
from streamlod.core.render.cpu.kernels.inline.constants import (
    EXTENT_X,
    EXTENT_Y,
    HALF,
    INLINE,
    KERNEL,
    MEAN_X,
    MEAN_Y,
    SERIAL,
    TILE_HEIGHT,
    TILE_WIDTH,
    ZERO,
)
from streamlod.core.render.cpu.kernels.inline.tile import ellipse_span, tile_span


@njit(**INLINE)
def _rows_near(record: Float32, y: Any, dilation: Any, rows: int) -> Any:
    """Rows of tiles [first, last] within `dilation` pixels of a Gaussian whose mean is at height `y`."""
    reach, height = record[EXTENT_Y] + dilation, np.float32(TILE_HEIGHT)
    first = max(0, math.floor(max(y - reach, ZERO) / height))
    return first, min(rows - 1, math.floor(min(y + reach, np.float32(rows * TILE_HEIGHT)) / height))


@njit(**INLINE)
def _tiles_near(record: Float32, x: Any, y: Any, tile_y: int, dilation: Any, columns: int) -> Any:
    """Tiles [start, stop] of a row of tiles within `dilation` pixels of a Gaussian whose mean is at x, y."""
    top, width = np.float32(tile_y * TILE_HEIGHT) - y, np.float32(TILE_WIDTH)
    left, right = ellipse_span(record, top - dilation, top + np.float32(TILE_HEIGHT - 1) + dilation)
    left, right = max(left, -record[EXTENT_X]), min(right, record[EXTENT_X])
    left, right = x + left - dilation, x + right + dilation
    if not (right >= ZERO and left < np.float32(columns * TILE_WIDTH)):
        return 0, -1
    start = math.floor(max(left, ZERO) / width)
    return start, math.floor(min(right, np.float32(columns * TILE_WIDTH - 1)) / width)


@njit(**{**SERIAL, "cache": True})
def count_near(records: Float32, depths: Float32, padding: Any, dilation: Any, counts: Int64) -> None:
    """Add to `counts` [tiles_y,tiles_x] the visible Gaussians that reach a tile if they may move `dilation` pixels.

    padding: what was added to each side of the picture before projecting, float32 pixels.
    """
    rows, columns = counts.shape
    for i in range(records.shape[0]):
        if not (depths[i] > ZERO):
            continue
        record = records[i]
        x, y = record[MEAN_X] - padding - HALF, record[MEAN_Y] - padding - HALF
        first, last = _rows_near(record, y, dilation, rows)
        for tile_y in range(first, last + 1):
            start, stop = _tiles_near(record, x, y, tile_y, dilation, columns)
            for tile_x in range(start, stop + 1):
                counts[tile_y, tile_x] += 1


@njit(**{**SERIAL, "cache": True})
def list_near(
    records: Float32, depths: Float32, order: Int64, padding: Any, dilation: Any, cursors: Int64, listed: Float32
) -> None:
    """Write the depths of those that `count_near` counts into the lists of their tiles.

    Args:
        order: [M] rows of the visible ones, near to far.
        cursors: [tiles_y,tiles_x] where each tile's list begins in `listed`; overwritten.
        listed: out, depths, ascending in each list.
    """
    rows, columns = cursors.shape
    for i in order:
        record = records[i]
        x, y = record[MEAN_X] - padding - HALF, record[MEAN_Y] - padding - HALF
        first, last = _rows_near(record, y, dilation, rows)
        for tile_y in range(first, last + 1):
            start, stop = _tiles_near(record, x, y, tile_y, dilation, columns)
            for tile_x in range(start, stop + 1):
                listed[cursors[tile_y, tile_x]] = depths[i]
                cursors[tile_y, tile_x] += 1


@njit(**SERIAL)
def _touches(record: Float32, box: Int32, mask: UInt8) -> bool:
    """Whether a Gaussian reaches a tile of `mask` [tiles_y,tiles_x]."""
    single = box[1] - box[0] == 1 or box[3] - box[2] == 1
    for tile_y in range(box[2], box[3]):
        start, stop = tile_span(record, box[0], box[1], tile_y, single)
        for tile_x in range(start, stop):
            if mask[tile_y, tile_x]:
                return True
    return False


@njit(**KERNEL)
def find_touching(workers: int, records: Float32, boxes: Int32, depths: Float32, mask: UInt8, touching: UInt8) -> None:
    """Set touching [N] to 1 for the visible Gaussians that reach a tile of `mask` [tiles_y,tiles_x], else to 0."""
    count = records.shape[0]
    for w in prange(workers):
        for i in range(count * w // workers, count * (w + 1) // workers):
            touching[i] = 1 if depths[i] > ZERO and _touches(records[i], boxes[i], mask) else 0


@njit(**KERNEL)
def count_reached(workers: int, records: Float32, boxes: Int32, depths: Float32, mask: UInt8, counts: Int32) -> None:
    """Tiles that each visible Gaussian reaches into counts [N,2], and those of `mask` [tiles_y,tiles_x] among them."""
    count = records.shape[0]
    for w in prange(workers):
        for i in range(count * w // workers, count * (w + 1) // workers):
            counts[i, 0] = counts[i, 1] = 0
            if not depths[i] > ZERO:
                continue
            box = boxes[i]
            single = box[1] - box[0] == 1 or box[3] - box[2] == 1
            for tile_y in range(box[2], box[3]):
                start, stop = tile_span(records[i], box[0], box[1], tile_y, single)
                for tile_x in range(start, stop):
                    counts[i, 0] += 1
                    counts[i, 1] += mask[tile_y, tile_x]
