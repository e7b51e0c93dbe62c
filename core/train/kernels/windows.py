"""Windows of pixels compared with other pictures at one depth after another."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from streamlod.core.arrays import Float32, Float64, Int64
from streamlod.core.render.cpu.kernels.inline.constants import KERNEL, SERIAL

HALF = 2  # half a window: 5x5 pixels
UNSEEN = 2.0  # the cost of a depth at which no other picture shows the point
_PIXELS = (2 * HALF + 1) ** 2
_COLOUR_CLAMP = 0.1  # a mean colour difference of this much or more is simply wrong
_FLAT = 1e-4  # variance of noise, of values in [0, 1]: keeps the correlation of flat windows near zero


@numba.njit(**SERIAL)
def _cost(own: Float32, moments: Float64, x: int, y: int, source: Float32, rays: Float64, shift: Float64) -> Any:
    """Of one window against `source` [H,W,3], warped by the homography `rays`, `shift`; UNSEEN if its middle is."""
    height, width = source.shape[:2]
    total, squares, products, difference = 0.0, 0.0, 0.0, 0.0
    for k in range(_PIXELS):
        px, py = x + k % (2 * HALF + 1) - HALF + 0.5, y + k // (2 * HALF + 1) - HALF + 0.5
        w = rays[2, 0] * px + rays[2, 1] * py + rays[2, 2] + shift[2]
        safe = 1.0 / max(w, 1e-9)
        u = (rays[0, 0] * px + rays[0, 1] * py + rays[0, 2] + shift[0]) * safe
        v = (rays[1, 0] * px + rays[1, 1] * py + rays[1, 2] + shift[1]) * safe
        if k == _PIXELS // 2 and not (w > 1e-9 and 0 < u < width and 0 < v < height):
            return UNSEEN
        u, v = min(max(u - 0.5, 0.0), width - 1.0), min(max(v - 0.5, 0.0), height - 1.0)
        x0, y0 = int(u), int(v)
        x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
        fu, fv = u - x0, v - y0
        grey = 0.0
        for channel in range(3):
            upper = source[y0, x0, channel] * (1 - fu) + source[y0, x1, channel] * fu
            lower = source[y1, x0, channel] * (1 - fu) + source[y1, x1, channel] * fu
            value = upper * (1 - fv) + lower * fv
            grey += value
            difference += abs(value - own[k, channel])
        grey /= 3
        total += grey
        squares += grey * grey
        products += grey * own[k, 3]
    mean = total / _PIXELS
    variance = max(squares / _PIXELS - mean * mean, 0.0) + _FLAT
    correlation = (products / _PIXELS - mean * moments[0]) / math.sqrt(variance * moments[1])
    return 0.5 * (1 - correlation) + min(difference / (3 * _PIXELS * _COLOUR_CLAMP), 1.0)


@numba.njit(**KERNEL)
def best_depths(
    workers: int,
    reference: Float32,
    sources: Float32,
    rays: Float64,
    shifts: Float64,
    inverse: Float64,
    column: Int64,
    row: Int64,
    plane: Int64,
    cost: Float32,
) -> None:
    """The best of the depths `inverse` for each of n pixels of `reference`.

    The cost of a depth is half of one minus the correlation of two windows, plus their clamped mean colour difference;
    of the two sources that match best, since the point may be hidden from the others.

    Args:
        reference: [H,W,3] picture in [0, 1]; sources: [S,H,W,3], S > 0.
        rays: [S,3,3], shifts: [S,3]: source s sees the reference's pixel (x, y, 1) at inverse depth d at the
            homogeneous pixel rays[s] @ (x, y, 1) + shifts[s] d.
        inverse: [D] inverse depths. column, row: [n] of the pixels.
        plane: out, [n] number of the best depth; cost: out, [n] its cost.
    """
    count, (height, width) = len(column), reference.shape[:2]
    for worker in numba.prange(workers):
        own, moments = np.empty((_PIXELS, 4), np.float32), np.empty(2)
        for i in range(count * worker // workers, count * (worker + 1) // workers):
            total, squares = 0.0, 0.0
            for k in range(_PIXELS):
                x = min(max(column[i] + k % (2 * HALF + 1) - HALF, 0), width - 1)
                y = min(max(row[i] + k // (2 * HALF + 1) - HALF, 0), height - 1)
                own[k, :3] = reference[y, x]
                own[k, 3] = (own[k, 0] + own[k, 1] + own[k, 2]) / 3
                total += own[k, 3]
                squares += own[k, 3] * own[k, 3]
            moments[0] = total / _PIXELS
            moments[1] = max(squares / _PIXELS - moments[0] ** 2, 0.0) + _FLAT
            plane[i], cost[i] = 0, 2 * UNSEEN
            for d in range(len(inverse)):
                first, second = UNSEEN, UNSEEN
                for s in range(len(sources)):
                    found = _cost(own, moments, column[i], row[i], sources[s], rays[s], shifts[s] * inverse[d])
                    second = min(second, max(first, found))
                    first = min(first, found)
                if first + second < cost[i]:
                    plane[i], cost[i] = d, first + second
            cost[i] *= 0.5
