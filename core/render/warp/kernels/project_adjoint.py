"""Gradients of the projection: from sums over pixels to means, quaternions, scales, opacities and colours.

Chain: sums -> mean and conic in the picture -> covariance (d inverse = -C^-1 dC C^-1) -> P = J W R S -> its factors, as
`core.render.cpu.kernels.project_backward` writes it.
"""

from __future__ import annotations

import warp as wp

from streamlod.core.render.warp.kernels.geometry import (
    camera_rotation,
    camera_vector,
    held_slopes,
    rotation,
    row_to_picture,
)
from streamlod.core.render.warp.kernels.rules import FOCAL_X, FOCAL_Y, GAIN, Cloud, Layer, TileGrid


@wp.struct
class Slopes:
    """Derivatives of the loss by a Gaussian's mean, quaternion (of any length) and scales."""

    mean: wp.vec3
    quaternion: wp.vec4
    scale: wp.vec3


@wp.func
def quaternion_slope(q: wp.vec4, inverse_norm: float, r: wp.mat33) -> wp.vec4:
    """dL/dq of a quaternion of any length from dL/dR, `q` its unit version."""
    w = q[0]
    x = q[1]
    y = q[2]
    z = q[3]
    slope = wp.vec4(
        2.0 * (x * (r[2, 1] - r[1, 2]) + y * (r[0, 2] - r[2, 0]) + z * (r[1, 0] - r[0, 1])),
        2.0
        * (
            -2.0 * x * (r[1, 1] + r[2, 2]) + y * (r[0, 1] + r[1, 0]) + z * (r[0, 2] + r[2, 0]) + w * (r[2, 1] - r[1, 2])
        ),
        2.0
        * (x * (r[0, 1] + r[1, 0]) - 2.0 * y * (r[0, 0] + r[2, 2]) + z * (r[1, 2] + r[2, 1]) + w * (r[0, 2] - r[2, 0])),
        2.0
        * (x * (r[0, 2] + r[2, 0]) + y * (r[1, 2] + r[2, 1]) - 2.0 * z * (r[0, 0] + r[1, 1]) + w * (r[1, 0] - r[0, 1])),
    )
    return (slope - q * wp.dot(slope, q)) * inverse_norm  # the part along q changes its length only


@wp.func
def depth_slope(focal: float, inverse_z: float, held: float, slope: float, screen: float, e: wp.vec2) -> wp.vec2:
    """dL/dx and the share of dL/dz of one axis of the picture; `e`: dL/d of the Jacobian's two entries in its row."""
    inverse_z2 = inverse_z * inverse_z
    across = focal * inverse_z * screen
    depth = -focal * slope * screen * inverse_z - inverse_z2 * focal * e[0]
    # the entry -focal slope / z, where the slope follows the mean only inside its limits
    if held == slope:
        across -= focal * inverse_z2 * e[1]
        depth += 2.0 * focal * held * inverse_z2 * e[1]
    else:
        depth += focal * held * inverse_z2 * e[1]
    return wp.vec2(across, depth)


@wp.func
def slopes_of(
    mean: wp.vec3,
    quaternion: wp.vec4,
    scale: wp.vec3,
    cameras: wp.array2d[float],
    c: int,
    grid: TileGrid,
    screen: wp.vec2,
    g: wp.vec3,
) -> Slopes:
    """From dL/d(mean in the picture) and dL/dcovariance `g` (xx, xy, yy)."""
    turn = camera_rotation(cameras, c)
    p = turn * mean + camera_vector(cameras, c, 9)
    inverse_z = 1.0 / p[2]
    held = held_slopes(cameras, c, p, grid.width, grid.height)
    fx = cameras[c, FOCAL_X]
    fy = cameras[c, FOCAL_Y]
    right = wp.vec3(turn[0, 0], turn[0, 1], turn[0, 2])
    down = wp.vec3(turn[1, 0], turn[1, 1], turn[1, 2])
    forward = wp.vec3(turn[2, 0], turn[2, 1], turn[2, 2])
    row_x = row_to_picture(right, forward, fx, held[0], inverse_z)
    row_y = row_to_picture(down, forward, fy, held[1], inverse_z)
    inverse_norm = 1.0 / wp.sqrt(wp.dot(quaternion, quaternion))
    q = quaternion * inverse_norm
    r = rotation(q)
    a = wp.transpose(r) * row_x
    b = wp.transpose(r) * row_y
    out = Slopes()
    # dL/dP = 2 G P with P = (a; b) diag(scale); u and v are its rows, then times the scale for dL/d(J W R)
    u = wp.cw_mul(2.0 * (g[0] * a + g[1] * b), scale)
    v = wp.cw_mul(2.0 * (g[1] * a + g[2] * b), scale)
    out.scale = wp.cw_mul(u, a) + wp.cw_mul(v, b)
    u = wp.cw_mul(u, scale)
    v = wp.cw_mul(v, scale)
    out.quaternion = quaternion_slope(q, inverse_norm, wp.outer(row_x, u) + wp.outer(row_y, v))
    # dL/d(J W) = dL/d(J W R) R^T, then dL/dJ = that W^T
    e = r * u
    f = r * v
    by_x = depth_slope(
        fx, inverse_z, held[0], p[0] * inverse_z, screen[0], wp.vec2(wp.dot(right, e), wp.dot(forward, e))
    )
    by_y = depth_slope(
        fy, inverse_z, held[1], p[1] * inverse_z, screen[1], wp.vec2(wp.dot(down, f), wp.dot(forward, f))
    )
    out.mean = right * by_x[0] + down * by_y[0] + forward * (by_x[1] + by_y[1])
    return out


@wp.kernel(enable_backward=False, grid_stride=False, launch_bounds=(256, 2))
def differentiate_projection(
    count: wp.array[int],
    cloud: Cloud,
    chosen: wp.array[int],
    cameras: wp.array2d[float],
    grid: TileGrid,
    layer: Layer,
    sums: wp.array3d[float],
    by: Cloud,
) -> None:
    """Grid (D, capacity of Gaussians), D as in `Cloud`.

    Args:
        count, cloud, chosen, cameras, layer: as for `project`; sums: [V,G,9] of `differentiate_blend`.
        by: out, the loss's gradient by every number of `cloud`.
    """
    d, i = wp.tid()
    to_mean = wp.vec3(0.0, 0.0, 0.0)
    to_quaternion = wp.vec4(0.0, 0.0, 0.0, 0.0)
    to_scale = wp.vec3(0.0, 0.0, 0.0)
    to_colour = wp.vec3(0.0, 0.0, 0.0)
    to_opacity = float(0.0)
    first = int(0)
    last = chosen.shape[0]
    if cloud.means.shape[0] > 1:
        first = d
        last = d + 1
    if i >= count[0]:
        return
    for v in range(first, last):
        place = layer.place[v, i]
        if place[2] > 0.0:
            c = chosen[v]
            k = layer.conic[v, i]
            tint = wp.vec3(sums[v, i, 0], sums[v, i, 1], sums[v, i, 2])
            to_colour += wp.cw_mul(tint, camera_vector(cameras, c, GAIN))
            to_opacity -= sums[v, i, 3] / place[2]
            x = sums[v, i, 4]
            y = sums[v, i, 5]
            screen = wp.vec2(-(k[0] * x + k[1] * y), -(k[1] * x + k[2] * y))
            xx = 0.5 * sums[v, i, 6]
            xy = 0.5 * sums[v, i, 7]
            yy = 0.5 * sums[v, i, 8]
            # -C G C for the conic C and dL/dC = G, symmetric
            a0 = k[0] * xx + k[1] * xy
            a1 = k[0] * xy + k[1] * yy
            b0 = k[1] * xx + k[2] * xy
            b1 = k[1] * xy + k[2] * yy
            g = wp.vec3(-(a0 * k[0] + a1 * k[1]), -(a0 * k[1] + a1 * k[2]), -(b0 * k[1] + b1 * k[2]))
            s = slopes_of(cloud.means[d, i], cloud.quaternions[d, i], cloud.scales[d, i], cameras, c, grid, screen, g)
            to_mean += s.mean
            to_quaternion += s.quaternion
            to_scale += s.scale
    by.means[d, i] = to_mean
    by.quaternions[d, i] = to_quaternion
    by.scales[d, i] = to_scale
    by.opacities[d, i] = to_opacity
    by.colours[d, i] = to_colour
