"""Blend tiles front to back (Kerbl et al., 3D Gaussian splatting, 2023, equation 3), eight pixels at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange

from streamlod.core.arrays import Float32, Int32, Int64
from streamlod.core.render.cpu.kernels.inline.constants import (
    ALPHA_MAX,
    BLUE,
    CONIC_A,
    CONIC_B,
    CONIC_C,
    CUT,
    GREEN,
    HALF,
    INLINE,
    KERNEL,
    LANES,
    MEAN_X,
    MEAN_Y,
    ONE,
    OPACITY,
    RECORD,
    RED,
    SERIAL,
    TILE_HEIGHT,
    TILE_PIXELS,
    TILE_WIDTH,
    TRANSMITTANCE_MIN,
    ZERO,
)
from streamlod.core.render.cpu.kernels.inline.simd import (
    above,
    at_least,
    choose,
    keep_where,
    lane_numbers,
    load,
    lower_of,
    minus_magnitude,
    prefetch,
    splat,
    store,
)
from streamlod.core.render.cpu.kernels.inline.tile import any_unfinished, behind_layer, exp_of_8, reached_part

_AHEAD = 8  # list entries between asking for a record and using it
_CHECK = 32  # Gaussians between looks at whether the tile is finished


@njit(**INLINE)
def _blend(pixels: Float32, at: Any, gaussian: Any, dx: Any, by: Any, cyy: Any) -> None:
    """Add one Gaussian to eight pixels. pixels: planes of transmittance, red, green, blue; `at`: first pixel."""
    conic_a, opacity, cut, red, green, blue = gaussian
    exponent = (conic_a * dx + by) * dx + cyy  # -sigma / 8
    transmittance = load(pixels, at)
    alpha = lower_of(opacity * exp_of_8(exponent), ALPHA_MAX)
    absorbed = keep_where(at_least(exponent, cut), alpha) * transmittance
    passed = transmittance - absorbed
    alive = above(passed, TRANSMITTANCE_MIN)  # false for finished pixels too: theirs is negative
    weight = keep_where(alive, absorbed)
    store(pixels, at + TILE_PIXELS, load(pixels, at + TILE_PIXELS) + weight * red)
    store(pixels, at + 2 * TILE_PIXELS, load(pixels, at + 2 * TILE_PIXELS) + weight * green)
    store(pixels, at + 3 * TILE_PIXELS, load(pixels, at + 3 * TILE_PIXELS) + weight * blue)
    store(pixels, at, choose(alive, passed, minus_magnitude(transmittance)))


@njit(**INLINE)
def blend_gaussian(pixels: Float32, record: Float32, x: Any, y: Any, rows: int) -> None:
    """Add one Gaussian to a tile; x, y: its mean relative to the tile's first pixel centre."""
    gaussian = (
        splat(record[CONIC_A]),
        splat(record[OPACITY]),
        splat(record[CUT]),
        splat(record[RED]),
        splat(record[GREEN]),
        splat(record[BLUE]),
    )
    conic_b, conic_c = record[CONIC_B], record[CONIC_C]
    top, bottom, left, right = reached_part(record, x, y, rows)
    dx_left = lane_numbers() + (np.float32(left * LANES) - x)
    dx_right = lane_numbers() + (np.float32(right * LANES) - x)
    for row in range(top, bottom + 1):
        dy = np.float32(row) - y
        by, cyy = splat(conic_b * dy), splat(conic_c * dy * dy)
        _blend(pixels, row * TILE_WIDTH + left * LANES, gaussian, dx_left, by, cyy)
        if right > left:
            _blend(pixels, row * TILE_WIDTH + right * LANES, gaussian, dx_right, by, cyy)


@njit(**INLINE)
def blend_layer(pixels: Float32, layer: Float32) -> None:
    """Add a layer to a tile: what several Gaussians came to, blended before. Planes of both as in `_blend`."""
    for at in range(0, TILE_PIXELS, LANES):
        transmittance = load(pixels, at)
        light = keep_where(above(transmittance, ZERO), transmittance)
        for plane in range(TILE_PIXELS, 4 * TILE_PIXELS, TILE_PIXELS):
            store(pixels, at + plane, load(pixels, at + plane) + light * load(layer, at + plane))
        store(pixels, at, behind_layer(transmittance, load(layer, at)))


@njit(**SERIAL)
def _blend_tile(
    tile: int,
    tiles_x: int,
    layers: Float32,
    records: Float32,
    offsets: Int64,
    lists: Int32,
    background: Float32,
    image: Float32,
    transmittance: Float32,
    pixels: Float32,
) -> None:
    """Render one tile. pixels: work memory, four planes of a tile: transmittance, red, green, blue."""
    tile_y = tile // tiles_x
    x0, y0 = (tile - tile_y * tiles_x) * TILE_WIDTH, tile_y * TILE_HEIGHT
    rows, columns = min(TILE_HEIGHT, image.shape[0] - y0), min(TILE_WIDTH, image.shape[1] - x0)
    for p in range(TILE_PIXELS):
        inside = p // TILE_WIDTH < rows and p % TILE_WIDTH < columns
        pixels[p] = ONE if inside else -ONE  # outside the picture: finished
    for p in range(TILE_PIXELS, 4 * TILE_PIXELS):
        pixels[p] = ZERO
    start, stop = offsets[tile], offsets[tile + 1]
    for entry in range(start, stop):
        prefetch(records, np.int64(lists[min(entry + _AHEAD, stop - 1)]) * RECORD)
        rank = lists[entry]
        if rank < layers.shape[0]:
            blend_layer(pixels, layers[rank])
        else:
            record = records[rank]
            x, y = record[MEAN_X] - (np.float32(x0) + HALF), record[MEAN_Y] - (np.float32(y0) + HALF)
            blend_gaussian(pixels, record, x, y, rows)
        if (entry - start) % _CHECK == _CHECK - 1 and not any_unfinished(pixels):
            break
    for row in range(rows):
        for column in range(columns):
            p = row * TILE_WIDTH + column
            light = abs(pixels[p])
            transmittance[y0 + row, x0 + column] = light
            for channel in range(3):
                image[y0 + row, x0 + column, channel] = (
                    pixels[(channel + 1) * TILE_PIXELS + p] + light * background[channel]
                )


@njit(**KERNEL)
def blend_tiles(
    tiles: Int32,
    bounds: Int64,
    tiles_x: int,
    layers: Float32,
    records: Float32,
    offsets: Int64,
    lists: Int32,
    background: Float32,
    image: Float32,
    transmittance: Float32,
) -> None:
    """Render tiles.

    Args:
        tiles: numbers of the tiles to render. bounds: [workers+1] worker w takes tiles[bounds[w]:bounds[w+1]].
        layers: [L,1024] see `kernels.layers`; ranks below L are layers.
        records [M,16] in depth order, offsets [T+1], lists [pairs]: from `binning`.
        background: [3]. image [H,W,3], transmittance [H,W]: out, the pixels of `tiles` only.
    """
    for w in prange(bounds.shape[0] - 1):
        pixels = np.empty(4 * TILE_PIXELS, np.float32)
        for k in range(bounds[w], bounds[w + 1]):
            _blend_tile(tiles[k], tiles_x, layers, records, offsets, lists, background, image, transmittance, pixels)
