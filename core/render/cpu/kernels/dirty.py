"""Which tiles Gaussians touch, and which Gaussians touch given tiles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, prange

from streamlod.core.arrays import Float32, Int32, UInt8
from streamlod.core.render.cpu.kernels.inline.constants import (
    EXTENT_X,
    EXTENT_Y,
    HALF,
    KERNEL,
    MEAN_X,
    MEAN_Y,
    SERIAL,
    TILE_HEIGHT,
    TILE_WIDTH,
    ZERO,
)
from streamlod.core.render.cpu.kernels.inline.tile import ellipse_span, tile_span


@njit(**{**SERIAL, "cache": True})
def mark_tiles(records: Float32, depths: Float32, padding: Any, dilation: Any, mask: UInt8) -> None:
    """Set `mask` [tiles_y,tiles_x] to 1 at tiles that a visible Gaussian reaches if it may move `dilation` pixels.

    padding: what was added to each side of the picture before projecting, float32 pixels.
    """
    rows, columns = mask.shape
    band = np.float32(TILE_HEIGHT - 1)
    for i in range(records.shape[0]):
        if not (depths[i] > ZERO):
            continue
        record = records[i]
        x, y = record[MEAN_X] - padding - HALF, record[MEAN_Y] - padding - HALF
        reach = record[EXTENT_Y] + dilation
        first = max(0, math.floor(max(y - reach, ZERO) / np.float32(TILE_HEIGHT)))
        last = min(rows - 1, math.floor(min(y + reach, np.float32(rows * TILE_HEIGHT)) / np.float32(TILE_HEIGHT)))
        for tile_y in range(first, last + 1):
            top = np.float32(tile_y * TILE_HEIGHT) - y
            left, right = ellipse_span(record, top - dilation, top + band + dilation)
            left, right = max(left, -record[EXTENT_X]), min(right, record[EXTENT_X])
            left, right = x + left - dilation, x + right + dilation
            if not (right >= ZERO and left < np.float32(columns * TILE_WIDTH)):
                continue
            start = math.floor(max(left, ZERO) / np.float32(TILE_WIDTH))
            stop = math.floor(min(right, np.float32(columns * TILE_WIDTH - 1)) / np.float32(TILE_WIDTH))
            for tile_x in range(start, stop + 1):
                mask[tile_y, tile_x] = 1


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
