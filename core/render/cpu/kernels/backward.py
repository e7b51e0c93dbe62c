"""Gradients of blending, front to back like the forward pass.

With v = dL/dpixel and C_i the colours, walk the same Gaussians again and keep rem = v . (what lies behind): it starts
as v . C_final + dL/dT T_final and loses w_i v . C_i at each; then dL/dsigma_i = alpha rem / (1 - alpha) - w_i v . C_i.
Nothing but the picture and its transmittance is kept from the forward pass; transmittances are recomputed bit by bit.
"""

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
    SUMS,
    TILE_HEIGHT,
    TILE_PIXELS,
    TILE_WIDTH,
    TRANSMITTANCE_MIN,
    ZERO,
)
from streamlod.core.render.cpu.kernels.inline.simd import (
    above,
    at_least,
    both,
    choose,
    keep_where,
    lane_numbers,
    lane_sum,
    lane_sums,
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
_BEHIND = 4 * TILE_PIXELS  # planes of `pixels`: transmittance, dL/d red, green, blue, rem


@njit(**INLINE)
def _absorb(pixels: Float32, at: Any, gaussian: Any, dx: Any, by: Any, cyy: Any) -> Any:
    """Blend one Gaussian into eight pixels; returns its weight and dL/dsigma there."""
    conic_a, opacity, cut, red, green, blue = gaussian
    exponent = (conic_a * dx + by) * dx + cyy
    transmittance = load(pixels, at)
    full = opacity * exp_of_8(exponent)
    alpha = keep_where(at_least(exponent, cut), lower_of(full, ALPHA_MAX))
    absorbed = alpha * transmittance
    passed = transmittance - absorbed
    alive = above(passed, TRANSMITTANCE_MIN)
    weight = keep_where(alive, absorbed)
    own = weight * (
        red * load(pixels, at + TILE_PIXELS)
        + green * load(pixels, at + 2 * TILE_PIXELS)
        + blue * load(pixels, at + 3 * TILE_PIXELS)
    )
    behind = load(pixels, at + _BEHIND) - own
    store(pixels, at + _BEHIND, behind)
    store(pixels, at, choose(alive, passed, minus_magnitude(transmittance)))
    uncapped = both(alive, above(splat(ALPHA_MAX), full))
    return weight, keep_where(uncapped, alpha * behind / (ONE - alpha) - own)


@njit(**INLINE)
def _accumulate(pixels: Float32, at: Any, gaussian: Any, dx: Any, dy: Any, by: Any, cyy: Any, sums: Any) -> Any:
    """The nine sums after eight more pixels."""
    red, green, blue, s1, sx, sy, sxx, sxy, syy = sums
    weight, slope = _absorb(pixels, at, gaussian, dx, by, cyy)
    slope_x, slope_y = slope * dx, slope * dy
    return (
        red + weight * load(pixels, at + TILE_PIXELS),
        green + weight * load(pixels, at + 2 * TILE_PIXELS),
        blue + weight * load(pixels, at + 3 * TILE_PIXELS),
        s1 + slope,
        sx + slope_x,
        sy + slope_y,
        sxx + slope_x * dx,
        sxy + slope_x * dy,
        syy + slope_y * dy,
    )


@njit(**INLINE)
def _broadcast(record: Float32) -> Any:
    """The fields of a record that `_absorb` needs, each spread over eight lanes."""
    return (
        splat(record[CONIC_A]),
        splat(record[OPACITY]),
        splat(record[CUT]),
        splat(record[RED]),
        splat(record[GREEN]),
        splat(record[BLUE]),
    )


@njit(**INLINE)
def _sum_gaussian(pixels: Float32, record: Float32, x: Any, y: Any, rows: int) -> Any:
    """The nine sums of one Gaussian over a tile, as vectors."""
    gaussian, conic_b, conic_c = _broadcast(record), record[CONIC_B], record[CONIC_C]
    zero = splat(ZERO)
    sums = (zero, zero, zero, zero, zero, zero, zero, zero, zero)
    top, bottom, left, right = reached_part(record, x, y, rows)
    dx_left = lane_numbers() + (np.float32(left * LANES) - x)
    dx_right = lane_numbers() + (np.float32(right * LANES) - x)
    for row in range(top, bottom + 1):
        dy = np.float32(row) - y
        by, cyy, dy = splat(conic_b * dy), splat(conic_c * dy * dy), splat(dy)
        sums = _accumulate(pixels, row * TILE_WIDTH + left * LANES, gaussian, dx_left, dy, by, cyy, sums)
        if right > left:
            sums = _accumulate(pixels, row * TILE_WIDTH + right * LANES, gaussian, dx_right, dy, by, cyy, sums)
    return sums


@njit(**INLINE)
def _pass_gaussian(pixels: Float32, record: Float32, x: Any, y: Any, rows: int) -> None:
    """Blend a Gaussian that wants no gradients: the pixels are updated, its sums are not computed."""
    gaussian, conic_b, conic_c = _broadcast(record), record[CONIC_B], record[CONIC_C]
    top, bottom, left, right = reached_part(record, x, y, rows)
    for row in range(top, bottom + 1):
        dy = np.float32(row) - y
        by, cyy = splat(conic_b * dy), splat(conic_c * dy * dy)
        for chunk in range(left, right + 1):
            dx = lane_numbers() + (np.float32(chunk * LANES) - x)
            _absorb(pixels, row * TILE_WIDTH + chunk * LANES, gaussian, dx, by, cyy)


@njit(**INLINE)
def _pass_layer(pixels: Float32, layer: Float32) -> None:
    """Blend a layer, planes as of `blend_layer`: the pixels are updated."""
    for at in range(0, TILE_PIXELS, LANES):
        transmittance = load(pixels, at)
        own = keep_where(above(transmittance, ZERO), transmittance) * (
            load(layer, at + TILE_PIXELS) * load(pixels, at + TILE_PIXELS)
            + load(layer, at + 2 * TILE_PIXELS) * load(pixels, at + 2 * TILE_PIXELS)
            + load(layer, at + 3 * TILE_PIXELS) * load(pixels, at + 3 * TILE_PIXELS)
        )
        store(pixels, at + _BEHIND, load(pixels, at + _BEHIND) - own)
        store(pixels, at, behind_layer(transmittance, load(layer, at)))


@njit(**SERIAL)
def _load_tile(
    x0: int,
    y0: int,
    rows: int,
    columns: int,
    image: Float32,
    transmittance: Float32,
    image_gradient: Float32,
    light_gradient: Float32,
    pixels: Float32,
) -> None:
    """Initialise the five planes of a tile. light_gradient: [H,W] dL/dT, or [0,0] for none."""
    with_light = light_gradient.shape[0] > 0
    for p in range(TILE_PIXELS):
        pixels[p] = -ONE
    for p in range(TILE_PIXELS, 5 * TILE_PIXELS):
        pixels[p] = ZERO
    for row in range(rows):
        for column in range(columns):
            p, y, x = row * TILE_WIDTH + column, y0 + row, x0 + column
            pixels[p] = ONE
            behind = light_gradient[y, x] * transmittance[y, x] if with_light else ZERO
            for channel in range(3):
                gradient = image_gradient[y, x, channel]
                pixels[(channel + 1) * TILE_PIXELS + p] = gradient
                behind += gradient * image[y, x, channel]
            pixels[_BEHIND + p] = behind


@njit(**INLINE)
def _end_of_wanted(start: Any, stop: Any, order: Int32, lists: Int32, wanted: Any) -> Any:
    """End of the part of the list [start, stop) that matters: behind the last Gaussian that wants gradients."""
    while stop > start and order[lists[stop - 1]] >= wanted:
        stop -= 1
    return stop


@njit(**SERIAL)
def _differentiate_tile(
    tile: int,
    tiles_x: int,
    layers: Float32,
    records: Float32,
    order: Int32,
    offsets: Int64,
    lists: Int32,
    image: Float32,
    transmittance: Float32,
    image_gradient: Float32,
    light_gradient: Float32,
    sums: Float32,
    pixels: Float32,
) -> None:
    """Add the gradients of one tile to `sums` [G,9]. pixels: work memory, five planes of a tile."""
    start, wanted = offsets[tile], sums.shape[0]
    stop = _end_of_wanted(start, offsets[tile + 1], order, lists, wanted)
    if stop == start:
        return
    tile_y = tile // tiles_x
    x0, y0 = (tile - tile_y * tiles_x) * TILE_WIDTH, tile_y * TILE_HEIGHT
    rows, columns = min(TILE_HEIGHT, image.shape[0] - y0), min(TILE_WIDTH, image.shape[1] - x0)
    _load_tile(x0, y0, rows, columns, image, transmittance, image_gradient, light_gradient, pixels)
    for entry in range(start, stop):
        ahead = lists[min(entry + _AHEAD, stop - 1)]
        prefetch(records, np.int64(ahead) * RECORD)
        prefetch(sums, np.int64(min(order[ahead], wanted - 1)) * SUMS)
        rank = lists[entry]
        if rank < layers.shape[0]:
            _pass_layer(pixels, layers[rank])
        else:
            record, own_row = records[rank], np.int64(order[rank])
            x, y = record[MEAN_X] - (np.float32(x0) + HALF), record[MEAN_Y] - (np.float32(y0) + HALF)
            if own_row < wanted:
                red, green, blue, s1, sx, sy, sxx, sxy, syy = _sum_gaussian(pixels, record, x, y, rows)
                at = own_row * SUMS
                store(sums, at, load(sums, at) + lane_sums(red, green, blue, s1, sx, sy, sxx, sxy))
                sums[own_row, SUMS - 1] += lane_sum(syy)
            else:
                _pass_gaussian(pixels, record, x, y, rows)
        if (entry - start) % _CHECK == _CHECK - 1 and not any_unfinished(pixels):
            break


@njit(**KERNEL)
def differentiate_tiles(
    tiles: Int32,
    bounds: Int64,
    tiles_x: int,
    layers: Float32,
    records: Float32,
    order: Int32,
    offsets: Int64,
    lists: Int32,
    image: Float32,
    transmittance: Float32,
    image_gradient: Float32,
    light_gradient: Float32,
    sums: Float32,
) -> None:
    """Sum gradients over pixels, a slab of `sums` a worker: no two workers write to one place.

    Args:
        tiles, bounds, tiles_x, layers, records, offsets, lists: as for `blend_tiles`.
        order: [M] row of `sums` for each depth rank; a number beyond its last row means no gradients.
        image [H,W,3], transmittance [H,W]: as rendered. image_gradient [H,W,3]; light_gradient [H,W] or [0,0].
        sums: out, [workers,G,9] see `constants`.
    """
    for w in prange(bounds.shape[0] - 1):
        pixels = np.empty(5 * TILE_PIXELS, np.float32)
        own = sums[w]
        own[:] = ZERO
        for k in range(bounds[w], bounds[w + 1]):
            _differentiate_tile(
                tiles[k],
                tiles_x,
                layers,
                records,
                order,
                offsets,
                lists,
                image,
                transmittance,
                image_gradient,
                light_gradient,
                own,
                pixels,
            )
