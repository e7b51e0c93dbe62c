"""The compiled half of `core.initialise.stereo.patches`: costs of slanted windows, and a pass that finds better ones.

A plane is seen by a pinhole camera with an inverse depth that is linear in the pixels: d + a dx + b dy round a pixel.

Everything in this file is compiled together and calls nothing compiled elsewhere, so that the on-disk cache of compiled
code is renewed whenever a line here changes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from streamlod.core.arrays import Float32, Float64

RADIUS, STRIDE = 4, 2  # a window of 9x9 pixels, of which every second one is looked at: 25 samples
WINDOW = 2 * RADIUS // STRIDE + 1
SAMPLES = WINDOW**2
COLOUR_SCALE = 0.05  # a sample whose channels differ by so much from the centre's counts 1/e
COLOUR_CLAMP = 0.1  # a mean colour difference of this much or more is simply wrong
UNSEEN = 2.0  # the cost of a plane that no source sees: as bad as can be
LONE = 0.1  # added to the cost of a plane that only one source sees
FLAT = 1e-4  # variance of noise, of values in [0, 1]: keeps the correlation of flat windows near zero
MIN_WEIGHT = 0.3  # of a window that must lie in the source's picture
APART = 2.0  # pixels; surfaces that two views hold farther apart than this are not the same

_NEIGHBOURS = 8  # planes tried of neighbours: four beside the pixel and four farther off
_TRIALS = 3  # random changes: of the depth, of the slant, of both


class Pairs(NamedTuple):
    """One reference view of H x W pixels with its S sources.

    Source s sees the reference's pixel (x, y, 1) at inverse depth d at the homogeneous pixel
    rays[s] @ (x, y, 1) + shifts[s] d; `back_rays` and `back_shifts` lead from the sources to the reference.

    Attributes:
        reference: [H,W,3] picture in [0, 1]; weights: [H,W,25] of the samples of each window; sources: [S,H,W,3].
        rays, back_rays: [S,3,3]; shifts, back_shifts: [S,3].
        inverse: [S,H,W] inverse depths that the sources hold.
    """

    reference: Float32
    weights: Float32
    sources: Float32
    rays: Float64
    shifts: Float64
    back_rays: Float64
    back_shifts: Float64
    inverse: Float64


@numba.njit(parallel=True, nogil=True, cache=True, fastmath=True, error_model="numpy")
def window_weights(reference: Float32, weights: Float32) -> None:
    """Fill [H,W,25] `weights`: less for samples whose colour is not the centre's, none outside the picture; sum 1."""
    height, width = reference.shape[:2]
    for y in numba.prange(height):
        for x in range(width):
            k, total = 0, np.float32(0)
            for dy in range(-RADIUS, RADIUS + 1, STRIDE):
                for dx in range(-RADIUS, RADIUS + 1, STRIDE):
                    value = np.float32(0)
                    if 0 <= y + dy < height and 0 <= x + dx < width:
                        apart = np.float32(0)
                        for channel in range(3):
                            apart += abs(reference[y + dy, x + dx, channel] - reference[y, x, channel])
                        value = np.float32(math.exp(-apart / np.float32(3 * COLOUR_SCALE)))
                    weights[y, x, k] = value
                    total += value
                    k += 1
            for k in range(SAMPLES):
                weights[y, x, k] /= total


@numba.njit(parallel=True, nogil=True, cache=True, fastmath=True, error_model="numpy")
def plane_costs(pairs: Pairs, agreement: float, planes: Float64, cost: Float32) -> None:
    """Fill [H,W] `cost` with the costs of `planes` [H,W,3]: (d, a, b) of every pixel.

    Args:
        agreement: weight of how far apart the sources' own surfaces lie, 0 to look at the pictures alone.
    """
    height, width = cost.shape
    for y in numba.prange(height):
        for x in range(width):
            cost[y, x] = _cost(pairs, agreement, x, y, planes[y, x, 0], planes[y, x, 1], planes[y, x, 2])


@numba.njit(parallel=True, nogil=True, cache=True, fastmath=True, error_model="numpy")
def improve(
    pairs: Pairs,
    agreement: float,
    low: float,
    high: float,
    change: float,
    parity: int,
    turn: int,
    planes: Float64,
    cost: Float32,
) -> None:
    """Every pixel of one colour of a chessboard takes the best of its own plane, its neighbours' and random changes.

    Args:
        low, high: inverse depths between which planes lie.
        change: largest relative change of the depth that is tried.
        parity: 0 or 1, the colour.
        turn: number of the pass, which decides the random numbers and how far the farther neighbours are.
        planes: [H,W,3], changed in place; cost: [H,W] of these planes, changed with them.
    """
    height, width = cost.shape
    for y in numba.prange(height):
        for x in range((y + parity) % 2, width, 2):
            d, a, b, best = planes[y, x, 0], planes[y, x, 1], planes[y, x, 2], cost[y, x]
            for k in range(_NEIGHBOURS):
                reach, side = 1 if k < 4 else 5 + 10 * (turn % 2), k % 4
                ny = y + (reach if side == 0 else -reach if side == 1 else 0)
                nx = x + (reach if side == 2 else -reach if side == 3 else 0)
                if not (0 <= ny < height and 0 <= nx < width):
                    continue
                na, nb = planes[ny, nx, 1], planes[ny, nx, 2]
                nd = planes[ny, nx, 0] + na * (x - nx) + nb * (y - ny)
                if low <= nd <= high:
                    value = _cost(pairs, agreement, x, y, nd, na, nb)
                    if value < best:
                        d, a, b, best = nd, na, nb, value
            seed = np.uint64((y * width + x) * 2654435761 + turn * 40503 + parity * 7919 + 12345)
            for _ in range(3):
                seed, _first = _random(seed)
            for k in range(_TRIALS):
                seed, r0 = _random(seed)
                seed, r1 = _random(seed)
                seed, r2 = _random(seed)
                nd, na, nb = d, a, b
                if k != 1:
                    nd = d * (1 + change * r0)
                if k != 0:
                    na, nb = a + d * 0.2 * change * r1, b + d * 0.2 * change * r2
                if low <= nd <= high:
                    value = _cost(pairs, agreement, x, y, nd, na, nb)
                    if value < best:
                        d, a, b, best = nd, na, nb, value
            planes[y, x, 0], planes[y, x, 1], planes[y, x, 2], cost[y, x] = d, a, b, best


@numba.njit(nogil=True, fastmath=True, error_model="numpy", forceinline=True)
def _cost(pairs: Pairs, agreement: float, x: int, y: int, d: float, a: float, b: float) -> np.float32:
    """Mean cost of the two sources that match a plane best, since the others may be occluded."""
    first, second = np.float32(UNSEEN), np.float32(UNSEEN)
    for s in range(len(pairs.sources)):
        value = _source_cost(
            pairs.reference, pairs.sources[s], pairs.weights[y, x], pairs.rays[s], pairs.shifts[s], x, y, d, a, b
        )
        if value < np.float32(UNSEEN) and agreement > 0:
            value += np.float32(agreement * _apart(pairs, s, x, y, d) / APART)
            value = min(value, np.float32(UNSEEN - 0.01))
        if value < first:
            first, second = value, first
        elif value < second:
            second = value
    if second >= np.float32(UNSEEN):
        second = first + np.float32(2 * LONE)
    return min(np.float32(0.5) * (first + second), np.float32(UNSEEN))


@numba.njit(nogil=True, fastmath=True, error_model="numpy", forceinline=True)
def _apart(pairs: Pairs, s: int, x: int, y: int, d: float) -> float:
    """Pixels between (x, y) and where the surface is seen that source s holds at the same place; `APART` at most."""
    rays, shift, back, back_shift = pairs.rays[s], pairs.shifts[s], pairs.back_rays[s], pairs.back_shifts[s]
    px, py = x + 0.5, y + 0.5
    w = rays[2, 0] * px + rays[2, 1] * py + rays[2, 2] + shift[2] * d
    u = (rays[0, 0] * px + rays[0, 1] * py + rays[0, 2] + shift[0] * d) / w
    v = (rays[1, 0] * px + rays[1, 1] * py + rays[1, 2] + shift[1] * d) / w
    bottom, right = pairs.inverse.shape[1] - 1, pairs.inverse.shape[2] - 1
    there = pairs.inverse[s, min(int(v), bottom), min(int(u), right)]  # inside by float32 may be an edge by float64
    q = back[2, 0] * u + back[2, 1] * v + back[2, 2] + back_shift[2] * there
    if q <= 1e-9:
        return APART
    dx = (back[0, 0] * u + back[0, 1] * v + back[0, 2] + back_shift[0] * there) / q - px
    dy = (back[1, 0] * u + back[1, 1] * v + back[1, 2] + back_shift[1] * there) / q - py
    return min(math.sqrt(dx * dx + dy * dy), APART)


@numba.njit(nogil=True, fastmath=True, error_model="numpy", forceinline=True)
def _homography(rays: Float64, shift: Float64, x: int, y: int, d: float, a: float, b: float) -> tuple[np.float32, ...]:
    """Where a source sees the pixels of a plane: u, v and their divisor w at (x, y), each with its growth in x and y.

    They are linear in the pixels, so that each sample of a window takes a few additions.
    """
    px, py = x + 0.5, y + 0.5
    return (
        np.float32(rays[0, 0] * px + rays[0, 1] * py + rays[0, 2] + shift[0] * d),
        np.float32(rays[0, 0] + shift[0] * a),
        np.float32(rays[0, 1] + shift[0] * b),
        np.float32(rays[1, 0] * px + rays[1, 1] * py + rays[1, 2] + shift[1] * d),
        np.float32(rays[1, 0] + shift[1] * a),
        np.float32(rays[1, 1] + shift[1] * b),
        np.float32(rays[2, 0] * px + rays[2, 1] * py + rays[2, 2] + shift[2] * d),
        np.float32(rays[2, 0] + shift[2] * a),
        np.float32(rays[2, 1] + shift[2] * b),
    )


@numba.njit(nogil=True, fastmath=True, error_model="numpy", forceinline=True)
def _source_cost(
    reference: Float32,
    source: Float32,
    weights: Float32,
    rays: Float64,
    shift: Float64,
    x: int,
    y: int,
    d: float,
    a: float,
    b: float,
) -> np.float32:
    """Cost of a plane round the pixel (x, y) against one source; `UNSEEN` where it does not see the pixel."""
    height, width = source.shape[0], source.shape[1]
    third, half, zero, one, inset = np.float32(1 / 3), np.float32(0.5), np.float32(0), np.float32(1), np.float32(1.001)
    wide, high = np.float32(width), np.float32(height)
    u0, ux, uy, v0, vx, vy, w0, wx, wy = _homography(rays, shift, x, y, d, a, b)
    d0, da, db = np.float32(d), np.float32(a), np.float32(b)
    sw = s0 = s1 = s2 = s3 = s4 = s5 = zero
    for row in range(WINDOW):
        dy = np.float32(row * STRIDE - RADIUS)
        ur, vr, wr, dr = u0 + uy * dy, v0 + vy * dy, w0 + wy * dy, d0 + db * dy
        for column in range(WINDOW):
            weight = weights[np.uint64(row * WINDOW + column)]
            if weight < np.float32(1e-3):
                continue
            dx = np.float32(column * STRIDE - RADIUS)
            w = wr + wx * dx
            safe = one / max(w, np.float32(1e-9))
            u, v = (ur + ux * dx) * safe, (vr + vx * dx) * safe
            if not (w > np.float32(1e-9) and dr + da * dx > zero and zero < u < wide and zero < v < high):
                if row == RADIUS // STRIDE and column == RADIUS // STRIDE:
                    return np.float32(UNSEEN)
                continue
            u, v = min(max(u - half, zero), wide - inset), min(max(v - half, zero), high - inset)
            left, top = np.int32(u), np.int32(v)
            fu, fv = u - np.float32(left), v - np.float32(top)
            x0, y0 = np.uint32(left), np.uint32(top)  # unsigned: Numba need not ask whether they count from the end
            x1, y1 = x0 + np.uint32(1), y0 + np.uint32(1)
            w11 = fu * fv
            w01, w10 = fu - w11, fv - w11
            w00 = one - fu - w10
            yr, xr = np.uint64(y + row * STRIDE - RADIUS), np.uint64(x + column * STRIDE - RADIUS)
            grey = own = difference = zero
            for channel in range(3):
                value = source[y0, x0, channel] * w00 + source[y0, x1, channel] * w01
                value += source[y1, x0, channel] * w10 + source[y1, x1, channel] * w11
                mine = reference[yr, xr, channel]
                grey += value
                own += mine
                difference += abs(value - mine)
            grey, own = grey * third, own * third
            sw += weight
            s0 += weight * grey
            s1 += weight * grey * grey
            s2 += weight * grey * own
            s3 += weight * difference
            s4 += weight * own
            s5 += weight * own * own
    s3 *= third
    if sw < np.float32(MIN_WEIGHT):
        return np.float32(UNSEEN)
    share = one / sw
    mean, own = s0 * share, s4 * share
    variance = max(s1 * share - mean * mean, np.float32(0)) + np.float32(FLAT)
    own_variance = max(s5 * share - own * own, np.float32(0)) + np.float32(FLAT)
    correlation = (s2 * share - mean * own) / math.sqrt(variance * own_variance)
    return np.float32(np.float32(0.5) * (one - correlation) + min(s3 * share / np.float32(COLOUR_CLAMP), one))


@numba.njit(nogil=True, cache=True)
def _random(seed: np.uint64) -> tuple[np.uint64, float]:
    """(next seed, number in [-1, 1]) of xorshift64 (Marsaglia 2003)."""
    seed ^= seed << np.uint64(13)
    seed ^= seed >> np.uint64(7)
    seed ^= seed << np.uint64(17)
    return seed, 2.0 * (seed >> np.uint64(11)) / 9007199254740992.0 - 1.0
