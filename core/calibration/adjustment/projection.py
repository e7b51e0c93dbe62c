"""Projection through a lens with OpenCV's distortion, with its derivatives.

Formula: https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html
"""

from __future__ import annotations

import numpy as np

from streamlod.core.arrays import Float64

_MIN_DEPTH = 1e-6


def projected(lens: Float64, points: Float64) -> tuple[Float64, Float64, Float64]:
    """[N,2] pixels of `points` [N,3] in camera axes by `lens` [N,9] or [9], in the order fx, fy, cx, cy, k1, k2, p1,
    p2, k3; their derivatives by the points [N,2,3], and those by the lens [N,2,9]."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = np.broadcast_to(lens, (len(points), 9)).T
    z = np.maximum(points[:, 2], _MIN_DEPTH)
    x, y = points[:, 0] / z, points[:, 1] / z
    s = x * x + y * y
    radial = 1 + s * (k1 + s * (k2 + s * k3))
    growth = 2 * (k1 + s * (2 * k2 + s * 3 * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (s + 2 * x * x)
    v = y * radial + p1 * (s + 2 * y * y) + 2 * p2 * x * y
    ux = radial + x * x * growth + 2 * p1 * y + 6 * p2 * x
    mixed = x * y * growth + 2 * p1 * x + 2 * p2 * y
    vy = radial + y * y * growth + 6 * p1 * y + 2 * p2 * x
    zero, one = np.zeros_like(x), np.ones_like(x)
    by_plane = np.array([[fx * ux, fx * mixed], [fy * mixed, fy * vy]])
    from_point = np.array([[1 / z, zero, -x / z], [zero, 1 / z, -y / z]])
    by_point = np.einsum("ijn,jkn->nik", by_plane, from_point)
    by_lens = np.array(
        [
            [u, zero, one, zero, fx * x * s, fx * x * s**2, fx * 2 * x * y, fx * (s + 2 * x * x), fx * x * s**3],
            [zero, v, zero, one, fy * y * s, fy * y * s**2, fy * (s + 2 * y * y), fy * 2 * x * y, fy * y * s**3],
        ]
    )
    return np.stack([fx * u + cx, fy * v + cy], axis=1), by_point, np.moveaxis(by_lens, 2, 0)


def matrix_of(lens: Float64) -> Float64:
    """[3,3] OpenCV intrinsics of a lens [9]."""
    fx, fy, cx, cy = lens[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


def lens_of(matrix: Float64, distortion: Float64) -> Float64:
    """[9] lens of OpenCV's intrinsics [3,3] and distortion [5]."""
    return np.concatenate([[matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]], np.ravel(distortion)[:5]])
