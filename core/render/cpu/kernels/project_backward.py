"""Gradients of the projection: from sums over pixels to means, quaternions, scales, opacities and colours.

Chain: sums -> mean and conic in the picture -> covariance (d inverse = -C^-1 dC C^-1) -> P = J W R S -> its factors.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, prange

from streamlod.core.arrays import Float32, Int32
from streamlod.core.render.cpu.kernels.inline.constants import (
    CONIC_A,
    CONIC_B,
    CONIC_C,
    FOCAL_X,
    FOCAL_Y,
    HALF,
    INLINE,
    KERNEL,
    ONE,
    OPACITY,
    SERIAL,
    SUM_1,
    SUM_BLUE,
    SUM_GREEN,
    SUM_RED,
    SUM_X,
    SUM_XX,
    SUM_XY,
    SUM_Y,
    SUM_YY,
    SUMS,
    TWO,
)
from streamlod.core.render.cpu.kernels.inline.geometry import (
    clamp,
    rotation,
    slope_limits,
    times_matrix,
    to_camera,
    world_to_picture,
)

_A_SCALE, _B_SCALE = np.float32(-16), np.float32(-8)  # undo the scaling of the conic in a record


@njit(**INLINE)
def _covariance_gradient(a: Any, b: Any, c: Any, half_xx: Any, half_xy: Any, half_yy: Any) -> Any:
    """-C G C for the conic C = (a b; b c) and dL/dC = G, symmetric: xx, xy, yy."""
    ga0, ga1 = a * half_xx + b * half_xy, a * half_xy + b * half_yy
    gb0, gb1 = b * half_xx + c * half_xy, b * half_xy + c * half_yy
    return -(ga0 * a + ga1 * b), -(ga0 * b + ga1 * c), -(gb0 * b + gb1 * c)


@njit(**INLINE)
def _quaternion_gradient(q: Any, inverse_norm: Any, r: Any, out: Float32) -> None:
    """dL/dq of a quaternion of any length from dL/dR (nine numbers), q its unit version."""
    w, x, y, z = q
    dw = TWO * (x * (r[7] - r[5]) + y * (r[2] - r[6]) + z * (r[3] - r[1]))
    dx = TWO * (-TWO * x * (r[4] + r[8]) + y * (r[1] + r[3]) + z * (r[2] + r[6]) + w * (r[7] - r[5]))
    dy = TWO * (x * (r[1] + r[3]) - TWO * y * (r[0] + r[8]) + z * (r[5] + r[7]) + w * (r[2] - r[6]))
    dz = TWO * (x * (r[2] + r[6]) + y * (r[5] + r[7]) - TWO * z * (r[0] + r[4]) + w * (r[3] - r[1]))
    along = dw * w + dx * x + dy * y + dz * z  # the part along q changes its length only
    out[0], out[1] = (dw - w * along) * inverse_norm, (dx - x * along) * inverse_norm
    out[2], out[3] = (dy - y * along) * inverse_norm, (dz - z * along) * inverse_norm


@njit(**SERIAL)
def _differentiate_rows(  # noqa: PLR0915 - one formula, in one place
    start: int,
    stop: int,
    rows: Int32,
    records: Float32,
    sums: Float32,
    means: Float32,
    quaternions: Float32,
    scales: Float32,
    camera: Float32,
    width: int,
    height: int,
    to_means: Float32,
    to_quaternions: Float32,
    to_scales: Float32,
    to_opacities: Float32,
    to_colours: Float32,
    to_screen: Float32,
) -> None:
    """Rows [start, stop) of `differentiate_projection`."""
    low_x, high_x, low_y, high_y = slope_limits(camera, np.float32(width), np.float32(height))
    fx, fy = camera[FOCAL_X], camera[FOCAL_Y]
    total = np.empty(SUMS, np.float32)
    for k in range(start, stop):
        for s in range(SUMS):
            total[s] = sums[0, k, s]
        for w in range(1, sums.shape[0]):
            for s in range(SUMS):
                total[s] += sums[w, k, s]
        i = rows[k]
        record = records[i]
        to_colours[i, 0], to_colours[i, 1], to_colours[i, 2] = total[SUM_RED], total[SUM_GREEN], total[SUM_BLUE]
        to_opacities[i] = -total[SUM_1] / record[OPACITY]
        ca, cb, cc = _A_SCALE * record[CONIC_A], _B_SCALE * record[CONIC_B], _A_SCALE * record[CONIC_C]
        screen_x, screen_y = -(ca * total[SUM_X] + cb * total[SUM_Y]), -(cb * total[SUM_X] + cc * total[SUM_Y])
        to_screen[k, 0], to_screen[k, 1] = screen_x, screen_y
        gxx, gxy, gyy = _covariance_gradient(
            ca, cb, cc, HALF * total[SUM_XX], HALF * total[SUM_XY], HALF * total[SUM_YY]
        )

        x, y, z = to_camera(camera, means[i, 0], means[i, 1], means[i, 2])
        inverse_z = ONE / z
        slope_x, slope_y = x * inverse_z, y * inverse_z
        held_x, held_y = clamp(slope_x, low_x, high_x), clamp(slope_y, low_y, high_y)
        t = world_to_picture(camera, inverse_z, held_x, held_y)
        qw, qx, qy, qz = quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3]
        unit = ONE / math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        q = (qw * unit, qx * unit, qy * unit, qz * unit)
        r = rotation(q[0], q[1], q[2], q[3])
        a0, a1, a2 = times_matrix(t[0], t[1], t[2], r)
        b0, b1, b2 = times_matrix(t[3], t[4], t[5], r)
        s0, s1, s2 = scales[i, 0], scales[i, 1], scales[i, 2]

        # dL/dP = 2 G P with P = (a; b) diag(s); u, v are its rows, then times s for dL/d(J W R).
        u0, v0 = TWO * (gxx * a0 + gxy * b0) * s0, TWO * (gxy * a0 + gyy * b0) * s0
        u1, v1 = TWO * (gxx * a1 + gxy * b1) * s1, TWO * (gxy * a1 + gyy * b1) * s1
        u2, v2 = TWO * (gxx * a2 + gxy * b2) * s2, TWO * (gxy * a2 + gyy * b2) * s2
        to_scales[i, 0], to_scales[i, 1] = u0 * a0 + v0 * b0, u1 * a1 + v1 * b1
        to_scales[i, 2] = u2 * a2 + v2 * b2
        u0, u1, u2, v0, v1, v2 = u0 * s0, u1 * s1, u2 * s2, v0 * s0, v1 * s1, v2 * s2
        to_rotation = (
            t[0] * u0 + t[3] * v0,
            t[0] * u1 + t[3] * v1,
            t[0] * u2 + t[3] * v2,
            t[1] * u0 + t[4] * v0,
            t[1] * u1 + t[4] * v1,
            t[1] * u2 + t[4] * v2,
            t[2] * u0 + t[5] * v0,
            t[2] * u1 + t[5] * v1,
            t[2] * u2 + t[5] * v2,
        )
        _quaternion_gradient(q, unit, to_rotation, to_quaternions[i])

        # dL/d(J W) = dL/d(J W R) R^T, then dL/dJ = that W^T; J = (ax 0 bx; 0 ay by).
        e0, e1, e2 = (
            r[0] * u0 + r[1] * u1 + r[2] * u2,
            r[3] * u0 + r[4] * u1 + r[5] * u2,
            r[6] * u0 + r[7] * u1 + r[8] * u2,
        )
        f0, f1, f2 = (
            r[0] * v0 + r[1] * v1 + r[2] * v2,
            r[3] * v0 + r[4] * v1 + r[5] * v2,
            r[6] * v0 + r[7] * v1 + r[8] * v2,
        )
        to_ax, to_bx = (
            camera[0] * e0 + camera[1] * e1 + camera[2] * e2,
            camera[6] * e0 + camera[7] * e1 + camera[8] * e2,
        )
        to_ay, to_by = (
            camera[3] * f0 + camera[4] * f1 + camera[5] * f2,
            camera[6] * f0 + camera[7] * f1 + camera[8] * f2,
        )
        inverse_z2 = inverse_z * inverse_z
        gx, gy = fx * inverse_z * screen_x, fy * inverse_z * screen_y
        gz = -(fx * slope_x * screen_x + fy * slope_y * screen_y) * inverse_z - inverse_z2 * (fx * to_ax + fy * to_ay)
        # bx = -fx slope_x / z, where the slope follows the mean only inside its limits.
        if held_x == slope_x:
            gx -= fx * inverse_z2 * to_bx
            gz += TWO * fx * held_x * inverse_z2 * to_bx
        else:
            gz += fx * held_x * inverse_z2 * to_bx
        if held_y == slope_y:
            gy -= fy * inverse_z2 * to_by
            gz += TWO * fy * held_y * inverse_z2 * to_by
        else:
            gz += fy * held_y * inverse_z2 * to_by
        for d in range(3):
            to_means[i, d] = camera[d] * gx + camera[3 + d] * gy + camera[6 + d] * gz


@njit(**KERNEL)
def differentiate_projection(
    workers: int,
    rows: Int32,
    records: Float32,
    sums: Float32,
    means: Float32,
    quaternions: Float32,
    scales: Float32,
    camera: Float32,
    width: int,
    height: int,
    to_means: Float32,
    to_quaternions: Float32,
    to_scales: Float32,
    to_opacities: Float32,
    to_colours: Float32,
    to_screen: Float32,
) -> None:
    """Add up the workers' slabs of sums, and differentiate the projection.

    Args:
        rows: [G] ascending rows of the visible Gaussians that want gradients; sums: [slabs,G,9] in their order.
        records [N,16], means [N,3], quaternions [N,4], scales [N,3], camera [16]: as for `project`.
        to_*: out, [N,...] at `rows` only. to_screen: out, [G,2] dL/dmean in pixels.
    """
    count = rows.shape[0]
    for w in prange(workers):
        _differentiate_rows(
            count * w // workers,
            count * (w + 1) // workers,
            rows,
            records,
            sums,
            means,
            quaternions,
            scales,
            camera,
            width,
            height,
            to_means,
            to_quaternions,
            to_scales,
            to_opacities,
            to_colours,
            to_screen,
        )
