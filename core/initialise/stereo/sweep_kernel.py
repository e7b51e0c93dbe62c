"""The compiled half of the plane sweep: everything about one plane, so that planes run in parallel.

Everything in this file is compiled together and calls nothing compiled elsewhere, so that the on-disk cache of compiled
code is renewed whenever a line here changes.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from streamlod.core.arrays import Float32, Float64, Int64

HALF = 2  # half a window: 5x5 pixels
_SPAN = 2 * HALF + 1
COLOUR_CLAMP = 0.1  # a mean colour difference of this much or more is simply wrong
UNSEEN = 2.0  # the cost of a plane that no neighbour sees: as bad as can be
LONE = 0.1  # added to the cost of a plane that only one neighbour sees: nothing says that it is not occluded there
_FLAT = 1e-4  # variance of noise, of values in [0, 1]: keeps the correlation of flat windows near zero


@numba.njit(parallel=True, nogil=True, cache=True)
def cost_volume(
    reference: Float32, sources: Float32, rays: Float64, shifts: Float64, inverse: Float64, best: int, volume: Float32
) -> None:
    """Fill [D,H,W] `volume` with the cost of every plane at every pixel.

    Args:
        reference: [H,W,3] picture in [0, 1]; sources: [S,H,W,3].
        rays: [S,3,3], shifts: [S,3]: source s sees the reference's pixel (x, y, 1) at inverse depth d at the
            homogeneous pixel rays[s] @ (x, y, 1) + shifts[s] d.
        inverse: [D] inverse depths.
        best: 1 or 2, of how many sources the costs are averaged; of those that see the plane.
    """
    for plane in numba.prange(len(inverse)):
        _plane_cost(reference, sources, rays, shifts, inverse[plane], best, volume[plane])


@numba.njit(nogil=True, cache=True)
def best_planes(volume: Float32, apart: int, plane: Int64, cost: Float32, rival: Float32) -> None:
    """The best plane of every pixel of [D,H,W] `volume`, and how good any other is.

    Args:
        apart: planes up to so far from the best are the same surface.
        plane: [H,W] to be filled with the number of the best plane; cost: [H,W] with its cost.
        rival: [H,W] to be filled with the lowest cost of planes farther from the best.
    """
    planes, height, width = volume.shape
    plane[:], cost[:], rival[:] = 0, volume[0], np.inf
    for d in range(1, planes):
        for y in range(height):
            for x in range(width):
                if volume[d, y, x] < cost[y, x]:
                    plane[y, x], cost[y, x] = d, volume[d, y, x]
    for d in range(planes):
        for y in range(height):
            for x in range(width):
                if abs(d - plane[y, x]) > apart and volume[d, y, x] < rival[y, x]:
                    rival[y, x] = volume[d, y, x]


@numba.njit(nogil=True, cache=True)
def _plane_cost(
    reference: Float32, sources: Float32, rays: Float64, shifts: Float64, inverse: float, best: int, out: Float32
) -> None:
    height, width = out.shape
    first = np.full((height, width), np.float32(UNSEEN))
    second = np.full((height, width), np.float32(UNSEEN))
    cost = np.empty((height, width), np.float32)
    for source in range(len(sources)):
        _pair_cost(reference, sources[source], rays[source], shifts[source] * inverse, cost)
        for y in range(height):
            for x in range(width):
                value = cost[y, x]
                second[y, x] = min(second[y, x], max(first[y, x], value))
                first[y, x] = min(first[y, x], value)
    if best > 1:
        for y in range(height):
            for x in range(width):
                lone = second[y, x] >= np.float32(UNSEEN)
                other = first[y, x] + np.float32(2 * LONE) if lone else second[y, x]
                first[y, x] = min(np.float32(0.5) * (first[y, x] + other), np.float32(UNSEEN))
    _average_with_window(first, out)


@numba.njit(nogil=True, cache=True, fastmath=True)
def _pair_cost(  # noqa: PLR0915  (one pass over the rows: splitting it would cost the compiler its registers)
    reference: Float32, source: Float32, rays: Float64, shift: Float64, cost: Float32
) -> None:
    """[H,W] `cost` of one plane against one source [H,W,3].

    Five rows of window sums are kept: warped grey, its square, its product with the reference's grey, colour
    difference, and the reference's grey and square.
    """
    height, width = cost.shape
    warped = np.zeros((6, width + 2 * HALF), np.float32)
    rows = np.zeros((_SPAN, 6, width), np.float32)
    third, one = np.float32(1 / 3), np.float32(1)
    for y in range(height + HALF):
        if y < height:
            for x in range(width):
                px, py = x + 0.5, y + 0.5
                w = rays[2, 0] * px + rays[2, 1] * py + rays[2, 2] + shift[2]
                safe = 1.0 / max(w, 1e-9)
                u = (rays[0, 0] * px + rays[0, 1] * py + rays[0, 2] + shift[0]) * safe
                v = (rays[1, 0] * px + rays[1, 1] * py + rays[1, 2] + shift[1]) * safe
                seen = w > 1e-9 and 0 < u < width and 0 < v < height
                cost[y, x] = 0 if seen else UNSEEN
                u, v = min(max(u - 0.5, 0.0), width - 1.0), min(max(v - 0.5, 0.0), height - 1.0)
                x0, y0 = int(u), int(v)
                x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
                fu, fv = np.float32(u - x0), np.float32(v - y0)
                grey, own, difference = np.float32(0), np.float32(0), np.float32(0)
                for channel in range(3):
                    upper = source[y0, x0, channel] * (one - fu) + source[y0, x1, channel] * fu
                    lower = source[y1, x0, channel] * (one - fu) + source[y1, x1, channel] * fu
                    value = upper * (one - fv) + lower * fv
                    mine = reference[y, x, channel]
                    grey += value
                    own += mine
                    difference += abs(value - mine)
                grey, own = grey * third, own * third
                at = x + HALF
                warped[0, at], warped[1, at], warped[2, at] = grey, grey * grey, grey * own
                warped[3, at], warped[4, at], warped[5, at] = difference * third, own, own * own
            row = rows[y % _SPAN]
            for k in range(6):
                line = warped[k]
                for x in range(width):
                    row[k, x] = line[x] + line[x + 1] + line[x + 2] + line[x + 3] + line[x + 4]
        centre = y - HALF
        if centre >= 0:
            low, high = max(0, centre - HALF), min(height - 1, centre + HALF)
            for x in range(width):
                count = (high - low + 1) * (min(x + HALF, width - 1) - max(x - HALF, 0) + 1)
                share = one / np.float32(count)
                s0 = s1 = s2 = s3 = s4 = s5 = np.float32(0)
                for other in range(low, high + 1):
                    r = other % _SPAN
                    s0 += rows[r, 0, x]
                    s1 += rows[r, 1, x]
                    s2 += rows[r, 2, x]
                    s3 += rows[r, 3, x]
                    s4 += rows[r, 4, x]
                    s5 += rows[r, 5, x]
                mean, own = s0 * share, s4 * share
                variance = max(s1 * share - mean * mean, np.float32(0)) + np.float32(_FLAT)
                own_variance = max(s5 * share - own * own, np.float32(0)) + np.float32(_FLAT)
                correlation = (s2 * share - mean * own) / math.sqrt(variance * own_variance)
                colour = min(s3 * share / np.float32(COLOUR_CLAMP), one)
                if cost[centre, x] == 0:
                    cost[centre, x] = np.float32(0.5) * (one - correlation) + colour


@numba.njit(nogil=True, cache=True)
def _average_with_window(values: Float32, out: Float32) -> None:
    """[H,W] `out`: the mean of a value and the mean of the window round it, of the pixels that exist."""
    height, width = values.shape
    across = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            low, high = max(0, x - HALF), min(width - 1, x + HALF)
            total = np.float32(0)
            for other in range(low, high + 1):
                total += values[y, other]
            across[y, x] = total / np.float32(high - low + 1)
    for y in range(height):
        low, high = max(0, y - HALF), min(height - 1, y + HALF)
        share = np.float32(0.5) / np.float32(high - low + 1)
        for x in range(width):
            total = np.float32(0)
            for other in range(low, high + 1):
                total += across[other, x]
            out[y, x] = np.float32(0.5) * values[y, x] + share * total
