"""L1 + D-SSIM of two pictures and its gradient, row by row, in one pass that stays in cache.

A worker walks down its band of rows. Of each new row it keeps horizontal blurs of x, y, x^2, y^2, xy in a ring of
eleven rows; from a full ring it takes the SSIM (Wang et al. 2004, equation 13) of the row in the middle and its slopes
by x's blurs; their horizontal blurs go into a second ring, and from that come the gradients, five rows further up.
Outside the picture everything is zero, as in a zero-padded convolution. Rows are flat: a pixel's neighbour is three
floats away. Gradients are the same for any number of workers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange

from streamlod.core.arrays import Float32, Float64
from streamlod.core.render.cpu.kernels.inline.constants import INLINE, KERNEL, LANES, ONE, SERIAL, TWO, ZERO
from streamlod.core.render.cpu.kernels.inline.simd import load, splat, store

RADIUS = 5
_TAPS = 2 * RADIUS + 1
_window = np.exp(-((np.arange(_TAPS) - RADIUS) ** 2) / (2 * 1.5**2))
_W0, _W1, _W2, _W3, _W4, _W5 = (np.float32(w) for w in (_window / _window.sum())[RADIUS:])
_C1, _C2 = np.float32(0.01**2), np.float32(0.03**2)  # Wang et al. 2004, K1 and K2 for a range of 1
_CHANNELS = 3
_EDGE = RADIUS * _CHANNELS  # floats of a row's margin
_PICTURE_BLURS, _SLOPE_BLURS = 5, 3


@njit(**INLINE)
def _add_taps(x: Float32, y: Float32, left: Any, right: Any, weight: Any, sums: Any) -> Any:
    """Add two taps of equal weight to the five blurs."""
    xl, xr, yl, yr = load(x, left), load(x, right), load(y, left), load(y, right)
    return (
        sums[0] + weight * (xl + xr),
        sums[1] + weight * (yl + yr),
        sums[2] + weight * (xl * xl + xr * xr),
        sums[3] + weight * (yl * yl + yr * yr),
        sums[4] + weight * (xl * yl + xr * yr),
    )


@njit(**SERIAL)
def _blur_pictures(x: Float32, y: Float32, ring: Float32, line: int) -> None:
    """Horizontal blurs of x, y, x^2, y^2, xy of one row, into `line` of the ring [5,11,F]. x, y: rows with margins."""
    floats = ring.shape[2]
    plane = _TAPS * floats
    for j in range(0, floats, LANES):
        at, zero = j + _EDGE, splat(ZERO)
        sums = _add_taps(x, y, at, at, _W0 * np.float32(0.5), (zero, zero, zero, zero, zero))
        sums = _add_taps(x, y, at - 3, at + 3, _W1, sums)
        sums = _add_taps(x, y, at - 6, at + 6, _W2, sums)
        sums = _add_taps(x, y, at - 9, at + 9, _W3, sums)
        sums = _add_taps(x, y, at - 12, at + 12, _W4, sums)
        sums = _add_taps(x, y, at - 15, at + 15, _W5, sums)
        at = line * floats + j
        store(ring, at, sums[0])
        store(ring, at + plane, sums[1])
        store(ring, at + 2 * plane, sums[2])
        store(ring, at + 3 * plane, sums[3])
        store(ring, at + 4 * plane, sums[4])


@njit(**SERIAL)
def _blur_slopes(slopes: Float32, ring: Float32, line: int) -> None:
    """Horizontal blurs of the three slope rows [3,F+2 margins], into `line` of the ring [3,11,F]."""
    floats, length = ring.shape[2], slopes.shape[1]
    for k in range(_SLOPE_BLURS):
        for j in range(0, floats, LANES):
            at = k * length + j + _EDGE
            total = _W0 * load(slopes, at)
            total += _W1 * (load(slopes, at - 3) + load(slopes, at + 3))
            total += _W2 * (load(slopes, at - 6) + load(slopes, at + 6))
            total += _W3 * (load(slopes, at - 9) + load(slopes, at + 9))
            total += _W4 * (load(slopes, at - 12) + load(slopes, at + 12))
            total += _W5 * (load(slopes, at - 15) + load(slopes, at + 15))
            store(ring, (k * _TAPS + line) * floats + j, total)


@njit(**INLINE)
def _blur_down(ring: Float32, base: Any, rows: Any) -> Any:
    """Vertical blur at float `base` of a ring plane; rows: where the eleven rows begin, top to bottom."""
    total = _W0 * load(ring, base + rows[5])
    total += _W1 * (load(ring, base + rows[4]) + load(ring, base + rows[6]))
    total += _W2 * (load(ring, base + rows[3]) + load(ring, base + rows[7]))
    total += _W3 * (load(ring, base + rows[2]) + load(ring, base + rows[8]))
    total += _W4 * (load(ring, base + rows[1]) + load(ring, base + rows[9]))
    return total + _W5 * (load(ring, base + rows[0]) + load(ring, base + rows[10]))


@njit(**INLINE)
def _ring_rows(newest: Any, floats: Any) -> Any:
    """Where the rows of a full ring begin, oldest first."""
    return (
        (newest + 1) % _TAPS * floats,
        (newest + 2) % _TAPS * floats,
        (newest + 3) % _TAPS * floats,
        (newest + 4) % _TAPS * floats,
        (newest + 5) % _TAPS * floats,
        (newest + 6) % _TAPS * floats,
        (newest + 7) % _TAPS * floats,
        (newest + 8) % _TAPS * floats,
        (newest + 9) % _TAPS * floats,
        (newest + 10) % _TAPS * floats,
        newest * floats,
    )


@njit(**SERIAL)
def _similarity_row(ring: Float32, newest: int, similarity: Float32, slopes: Float32) -> None:
    """SSIM of the middle row of the ring, and its slopes by the blurs of x, x^2 and xy (rows of `slopes`)."""
    floats, length = ring.shape[2], slopes.shape[1]
    rows, plane = _ring_rows(newest, floats), _TAPS * floats
    for j in range(0, floats, LANES):
        a, b = _blur_down(ring, j, rows), _blur_down(ring, j + plane, rows)
        aa, bb = _blur_down(ring, j + 2 * plane, rows), _blur_down(ring, j + 3 * plane, rows)
        ab = _blur_down(ring, j + 4 * plane, rows)
        brightness, contrast = a * a + b * b + _C1, aa - a * a + bb - b * b + _C2
        product, correlation = TWO * a * b + _C1, TWO * (ab - a * b) + _C2
        inverse = ONE / (brightness * contrast)
        value = product * correlation * inverse
        by_square, by_product = ZERO - value / contrast, TWO * product * inverse
        by_mean = TWO * b * correlation * inverse - TWO * a * value / brightness - TWO * a * by_square - b * by_product
        store(similarity, j, value)
        store(slopes, j, by_mean)
        store(slopes, length + j, by_square)
        store(slopes, 2 * length + j, by_product)


@njit(**SERIAL)
def _blur_slopes_down(ring: Float32, newest: int, blurred: Float32) -> None:
    """Vertical blurs of the three slopes of the middle row of the ring into `blurred` [3,F]."""
    floats = ring.shape[2]
    rows = _ring_rows(newest, floats)
    for k in range(_SLOPE_BLURS):
        for j in range(0, floats, LANES):
            store(blurred, k * floats + j, _blur_down(ring, k * _TAPS * floats + j, rows))


@njit(**SERIAL)
def _gradient_row(x: Float32, y: Float32, pixel_weights: Float32, slopes: Float32, weights: Any, out: Float32) -> Any:
    """Gradient of a row of x, written to `out`; returns the row's weighted sum of |x - y|. slopes: [3,F], blurred."""
    l1_weight, ssim_weight = weights
    by_mean, by_square, by_product = slopes[0], slopes[1], slopes[2]
    total = ZERO
    for j in range(out.shape[0]):
        difference = x[j] - y[j]
        sign = ONE if difference > ZERO else (-ONE if difference < ZERO else ZERO)
        by_similarity = by_mean[j] + TWO * x[j] * by_square[j] + y[j] * by_product[j]
        out[j] = l1_weight * pixel_weights[j] * sign - ssim_weight * by_similarity
        total += pixel_weights[j] * abs(difference)
    return total


@njit(**SERIAL)
def _copy_row(picture: Float32, row: int, first: int, out: Float32) -> None:
    """Floats [first, first + len(out)) of a row into `out`, zeros beyond the picture's sides."""
    width = picture.shape[1]
    start, stop = max(first, 0), min(first + out.shape[0], width)
    out[: start - first] = ZERO
    out[start - first : stop - first] = picture[row, start:stop]
    out[stop - first :] = ZERO


@njit(**SERIAL)
def _sum_floats(values: Float32) -> Any:
    """Sum of `values`, as a loop that LLVM vectorises."""
    total = ZERO
    for j in range(values.shape[0]):
        total += values[j]
    return total


@njit(**SERIAL)
def _band(
    x: Float32,
    y: Float32,
    pixel_weights: Float32,
    left: int,
    right: int,
    top: int,
    bottom: int,
    above: int,
    below: int,
    weights: Any,
    out: Float32,
) -> Any:
    """Rows [top, bottom) of `photometric`; above, below: rows of similarity beyond them that this band counts."""
    height, width = x.shape
    wide = -(-(right - left) // LANES) * LANES  # floats of a row of gradients, from `left` on
    floats = wide + -(-2 * _EDGE // LANES) * LANES  # and of a row of blurs, from `left - _EDGE` on
    x_row, y_row = np.zeros(floats + 2 * _EDGE, np.float32), np.zeros(floats + 2 * _EDGE, np.float32)
    ring = np.zeros((_PICTURE_BLURS, _TAPS, floats), np.float32)
    slope_ring = np.zeros((_SLOPE_BLURS, _TAPS, wide), np.float32)
    similarity, slopes = np.zeros(floats, np.float32), np.zeros((_SLOPE_BLURS, floats + 2 * _EDGE), np.float32)
    blurred = np.zeros((_SLOPE_BLURS, wide), np.float32)
    inside_left = max(0, _EDGE - left)  # floats of a row of blurs that lie in the picture
    inside_right = min(width, right + _EDGE) - (left - _EDGE)
    l1, dissimilarity = 0.0, 0.0
    for row in range(top - 2 * RADIUS, bottom + 2 * RADIUS):
        line = (row - top + 2 * RADIUS) % _TAPS
        if 0 <= row < height:
            _copy_row(x, row, left - 2 * _EDGE, x_row)
            _copy_row(y, row, left - 2 * _EDGE, y_row)
            _blur_pictures(x_row, y_row, ring, line)
        else:
            ring[:, line] = ZERO
        middle = row - RADIUS
        if middle < top - RADIUS:
            continue
        if 0 <= middle < height:
            _similarity_row(ring, line, similarity, slopes)
            slopes[:, :inside_left] = ZERO
            slopes[:, inside_right:] = ZERO
            _blur_slopes(slopes, slope_ring, line)
            if top - above <= middle < bottom + below:
                dissimilarity += inside_right - inside_left - _sum_floats(similarity[inside_left:inside_right])
        else:
            slope_ring[:, line] = ZERO
        done = middle - RADIUS
        if done >= top:
            _blur_slopes_down(slope_ring, line, blurred)
            l1 += _gradient_row(
                x[done, left:right],
                y[done, left:right],
                pixel_weights[done, left:right],
                blurred,
                weights,
                out[done, left:right],
            )
    return l1, dissimilarity


@njit(**KERNEL)
def photometric(
    workers: int,
    x: Float32,
    y: Float32,
    pixel_weights: Float32,
    left: int,
    right: int,
    top: int,
    bottom: int,
    weights: Any,
    out: Float32,
    sums: Float64,
) -> None:
    """Sums over a box and gradients in it, as though of the whole picture.

    Args:
        workers: at most one a row of the box.
        x, y: [H,3W] pictures in [0, 1]. pixel_weights: [H,3W] weights of |x - y|.
        left, right: floats of a row, top, bottom: rows of the box; ends exclusive.
        weights: (of a unit of |x - y|, of a unit of 1 - SSIM), float32.
        out: [H,3W] gradient by x, written in the box only.
        sums: out, [workers,2] weighted |x - y| over the box, and 1 - SSIM over all pixels whose window touches it.
    """
    for w in prange(workers):
        first, last = top + (bottom - top) * w // workers, top + (bottom - top) * (w + 1) // workers
        above, below = RADIUS if w == 0 else 0, RADIUS if w == workers - 1 else 0
        sums[w, 0], sums[w, 1] = _band(x, y, pixel_weights, left, right, first, last, above, below, weights, out)
