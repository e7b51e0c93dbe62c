"""Gaussians to records: what binning and blending need of each, 64 bytes."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from streamlod.core.arrays import Float32, Int32
from streamlod.core.render.cpu.kernels.inline.constants import (
    ALPHA_MIN,
    CENTRE_X,
    CENTRE_Y,
    COLOUR_MAX,
    EIGHTH,
    FAR,
    FINITE,
    FOCAL_X,
    FOCAL_Y,
    HALF,
    KERNEL,
    LOW_PASS,
    MAX_ASIDE,
    MAX_SLOPE,
    MAX_SPREAD,
    NEAR,
    ONE,
    OPACITY_MAX,
    SERIAL,
    TILE_HEIGHT,
    TILE_WIDTH,
    TWO,
    ZERO,
)
from streamlod.core.render.cpu.kernels.inline.geometry import (
    clamp,
    rotation,
    slope_limits,
    times_matrix,
    to_camera,
    world_to_picture,
)

_INVISIBLE = np.float32(-1)
_MIN_DETERMINANT = np.float32(1e-12)  # pixels^4; flatter ellipses cannot be inverted
_ALPHA_LEVELS = np.float32(255)


@njit(**SERIAL)
def project_rows(  # noqa: PLR0915 - one formula, in one place
    start: int,
    stop: int,
    means: Float32,
    quaternions: Float32,
    scales: Float32,
    opacities: Float32,
    colours: Float32,
    camera: Float32,
    width: int,
    height: int,
    records: Float32,
    boxes: Int32,
    depths: Float32,
) -> None:
    """Rows [start, stop) of `project`. Every test is written such that a Gaussian with a NaN is left out."""
    wide, high = np.float32(width), np.float32(height)
    low_x, high_x, low_y, high_y = slope_limits(camera, wide, high)
    for i in range(start, stop):
        depths[i] = _INVISIBLE
        x, y, z = to_camera(camera, means[i, 0], means[i, 1], means[i, 2])
        opacity = opacities[i]
        if not (z > NEAR) or not (z < FAR) or not (opacity >= ALPHA_MIN) or not (opacity < FINITE):
            continue
        opacity = min(opacity, OPACITY_MAX)
        inverse_z = ONE / z
        mean_x = camera[FOCAL_X] * x * inverse_z + camera[CENTRE_X]
        mean_y = camera[FOCAL_Y] * y * inverse_z + camera[CENTRE_Y]
        is_close = abs(mean_x - HALF * wide) <= MAX_ASIDE * wide and abs(mean_y - HALF * high) <= MAX_ASIDE * high
        if not is_close and not (x * x + y * y <= MAX_SLOPE * MAX_SLOPE * z * z):
            continue

        # Covariance = P P^T + low pass, P = J W R(q) diag(scales), two rows of three.
        t = world_to_picture(
            camera, inverse_z, clamp(x * inverse_z, low_x, high_x), clamp(y * inverse_z, low_y, high_y)
        )
        qw, qx, qy, qz = quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3]
        unit = ONE / math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        r = rotation(qw * unit, qx * unit, qy * unit, qz * unit)
        a0, a1, a2 = times_matrix(t[0], t[1], t[2], r)
        b0, b1, b2 = times_matrix(t[3], t[4], t[5], r)
        s0, s1, s2 = scales[i, 0], scales[i, 1], scales[i, 2]
        c0, c1, c2 = times_matrix(camera[6], camera[7], camera[8], r)
        spread = c0 * c0 * s0 * s0 + c1 * c1 * s1 * s1 + c2 * c2 * s2 * s2
        if not (spread <= MAX_SPREAD * MAX_SPREAD * z * z):
            continue
        a0, a1, a2, b0, b1, b2 = a0 * s0, a1 * s1, a2 * s2, b0 * s0, b1 * s1, b2 * s2
        xx, yy, xy = a0 * a0 + a1 * a1 + a2 * a2, b0 * b0 + b1 * b1 + b2 * b2, a0 * b0 + a1 * b1 + a2 * b2
        # det(P P^T) as a sum of squared minors (Cauchy-Binet): no cancellation for needles.
        m0, m1, m2 = a0 * b1 - a1 * b0, a0 * b2 - a2 * b0, a1 * b2 - a2 * b1
        determinant = m0 * m0 + m1 * m1 + m2 * m2 + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS
        xx += LOW_PASS
        yy += LOW_PASS
        colour = abs(colours[i, 0]) + abs(colours[i, 1]) + abs(colours[i, 2])
        if not (colour < COLOUR_MAX) or not (abs(mean_x) + abs(mean_y) + determinant < FINITE):
            continue
        if not (determinant > _MIN_DETERMINANT):
            continue

        # Box of the ellipse where alpha falls to 1/255: sigma = cut.
        cut = math.log(opacity * _ALPHA_LEVELS)
        extent_x, extent_y = math.sqrt(TWO * cut * xx), math.sqrt(TWO * cut * yy)
        left, right = mean_x - extent_x - HALF, mean_x + extent_x - HALF
        top, bottom = mean_y - extent_y - HALF, mean_y + extent_y - HALF
        if not (right >= ZERO and bottom >= ZERO and left <= wide - ONE and top <= high - ONE):
            continue
        first_x, last_x = math.ceil(max(left, ZERO)), math.floor(min(right, wide - ONE))
        first_y, last_y = math.ceil(max(top, ZERO)), math.floor(min(bottom, high - ONE))
        if last_x < first_x or last_y < first_y:
            continue  # between pixel centres
        box = boxes[i]
        box[0], box[1] = first_x // TILE_WIDTH, last_x // TILE_WIDTH + 1
        box[2], box[3] = first_y // TILE_HEIGHT, last_y // TILE_HEIGHT + 1

        inverse = ONE / determinant
        conic_a, conic_b, conic_c = yy * inverse, -xy * inverse, xx * inverse
        record = records[i]  # fields in the order of `constants`
        record[0], record[1] = mean_x, mean_y
        record[2], record[3], record[4] = -HALF * conic_a * EIGHTH, -conic_b * EIGHTH, -HALF * conic_c * EIGHTH
        record[5], record[6] = opacity, -cut * EIGHTH
        record[7], record[8], record[9] = colours[i, 0], colours[i, 1], colours[i, 2]
        record[10], record[11], record[12] = extent_x, extent_y, xy / xx * extent_x
        record[13], record[14], record[15] = ONE / conic_a, TWO * cut * conic_a, inverse
        depths[i] = z


@njit(**KERNEL)
def project(
    workers: int,
    means: Float32,
    quaternions: Float32,
    scales: Float32,
    opacities: Float32,
    colours: Float32,
    camera: Float32,
    width: int,
    height: int,
    records: Float32,
    boxes: Int32,
    depths: Float32,
) -> None:
    """Project all Gaussians.

    Args:
        means [N,3], quaternions [N,4], scales [N,3], opacities [N], colours [N,3], camera [16]: see `constants`.
        records: out, [N,16]. boxes: out, [N,4] tiles left, right, top, bottom; ends exclusive.
        depths: out, [N] z in camera axes, -1 where the Gaussian cannot be seen; only then the rest is undefined.
    """
    count = means.shape[0]
    for w in prange(workers):
        project_rows(
            count * w // workers,
            count * (w + 1) // workers,
            means,
            quaternions,
            scales,
            opacities,
            colours,
            camera,
            width,
            height,
            records,
            boxes,
            depths,
        )
