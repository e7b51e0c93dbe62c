"""Shared by binning, forward and backward: which part of a tile a Gaussian can reach, and its falloff."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from streamlod.core.arrays import Float32
from streamlod.core.render.cpu.kernels.inline.constants import (
    CONIC_B,
    DETERMINANT,
    EIGHT,
    EXTENT_X,
    EXTENT_Y,
    HALF,
    INLINE,
    INVERSE_A,
    LANES,
    MEAN_X,
    MEAN_Y,
    ONE,
    REACH,
    SKEW,
    TILE_HEIGHT,
    TILE_PIXELS,
    TILE_WIDTH,
    TRANSMITTANCE_MIN,
    ZERO,
)
from streamlod.core.render.cpu.kernels.inline.geometry import clamp
from streamlod.core.render.cpu.kernels.inline.simd import (
    above,
    choose,
    higher_of,
    keep_where,
    lane_sum,
    load,
    lower_of,
    minus_magnitude,
    splat,
)

# exp(8 x) = p(x)^8: a polynomial of degree 5 on [-0.78, 0], squared three times; relative error 3e-6. That is range
# enough, since alpha >= 1/255 means sigma <= ln(255 OPACITY_MAX) = 6.234.
_MIN_EXPONENT = np.float32(-0.78)
_P0, _P1, _P2 = np.float32(0.999999848), np.float32(0.999987331), np.float32(0.499822211)
_P3, _P4, _P5 = np.float32(0.165728661), np.float32(0.0393661515), np.float32(0.00561156715)
_SLACK = np.float32(1e-3)  # of a tile, against rounding where an ellipse touches a tile's edge


@njit(**INLINE)
def exp_of_8(x: Any) -> Any:
    """exp(8 x), lane by lane; x below -0.78 counts as -0.78, above 0 as 0."""
    x = lower_of(higher_of(x, _MIN_EXPONENT), ZERO)
    p = x * _P5 + _P4
    p = p * x + _P3
    p = p * x + _P2
    p = p * x + _P1
    p = p * x + _P0
    p = p * p
    p = p * p
    return p * p


@njit(**INLINE)
def ellipse_span(record: Float32, top: Any, bottom: Any) -> Any:
    """Left and right end of the ellipse alpha = 1/255 over heights [top, bottom], all relative to its mean.

    The ends lie at the band's edge or at the tangent points dy = -+SKEW.
    """
    slope = record[CONIC_B] * EIGHT * record[INVERSE_A]
    dy = clamp(-record[SKEW], top, bottom)
    left = slope * dy - math.sqrt(max(ZERO, record[REACH] - record[DETERMINANT] * dy * dy)) * record[INVERSE_A]
    dy = clamp(record[SKEW], top, bottom)
    right = slope * dy + math.sqrt(max(ZERO, record[REACH] - record[DETERMINANT] * dy * dy)) * record[INVERSE_A]
    return left, right


@njit(**INLINE)
def tile_span(record: Float32, first: Any, last: Any, tile_y: Any, single: Any) -> Any:
    """Tiles [start, stop) of row `tile_y` that the ellipse alpha = 1/255 touches, within its box's [first, last).

    single: the box is one tile wide or high, so that all its tiles are touched.
    """
    start, stop = np.int64(first), np.int64(last)
    if not single:
        top = np.float32(tile_y * TILE_HEIGHT) + HALF - record[MEAN_Y]
        bottom = top + np.float32(TILE_HEIGHT - 1)
        left, right = ellipse_span(record, top, bottom)
        x = record[MEAN_X] - HALF
        start = max(start, np.int64(math.floor((x + left) / np.float32(TILE_WIDTH) - _SLACK)))
        stop = min(stop, np.int64(math.floor((x + right) / np.float32(TILE_WIDTH) + _SLACK)) + 1)
    return start, stop


@njit(**INLINE)
def reached_part(record: Float32, x: Any, y: Any, rows: Any) -> Any:
    """Rows [top, bottom] and chunks of eight pixels [left, right], one or two, of a tile inside the Gaussian's box.

    x, y: the mean relative to the tile's first pixel centre.
    """
    top = max(0, math.ceil(max(y - record[EXTENT_Y], ZERO)))
    bottom = math.floor(min(y + record[EXTENT_Y], np.float32(rows - 1)))
    # Clamped into the tile: after rounding, a list may name a Gaussian that ends just before the tile's edge.
    edge = np.float32(TILE_WIDTH - 1)
    left = int(min(max(x - record[EXTENT_X], ZERO), edge)) // LANES
    right = int(max(min(x + record[EXTENT_X], edge), ZERO)) // LANES
    return top, bottom, left, right


@njit(**INLINE)
def behind_layer(transmittance: Any, passes: Any) -> Any:
    """Transmittance of eight pixels behind a layer that lets `passes` through; minus it where they are finished."""
    left = choose(above(transmittance, ZERO), transmittance * passes, transmittance)
    return choose(above(left, TRANSMITTANCE_MIN), left, minus_magnitude(left))


@njit(**INLINE)
def any_unfinished(pixels: Float32) -> Any:
    """Whether a pixel of the tile still lets light through: finished pixels hold minus their transmittance."""
    best = load(pixels, 0)
    for at in range(LANES, TILE_PIXELS, LANES):
        best = higher_of(best, load(pixels, at))
    return lane_sum(keep_where(above(best, ZERO), splat(ONE))) > ZERO
