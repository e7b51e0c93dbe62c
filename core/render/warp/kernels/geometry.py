"""The projection's pieces that forward and backward share (Zwicker et al., EWA splatting, 2002, section 4)."""

from __future__ import annotations

import warp as wp

from streamlod.core.render.warp.kernels.rules import CENTRE_X, CENTRE_Y, FIELD_MARGIN, FOCAL_X, FOCAL_Y


@wp.func
def camera_rotation(cameras: wp.array2d[float], c: int) -> wp.mat33:
    """World to camera axes."""
    return wp.mat33(
        cameras[c, 0],
        cameras[c, 1],
        cameras[c, 2],
        cameras[c, 3],
        cameras[c, 4],
        cameras[c, 5],
        cameras[c, 6],
        cameras[c, 7],
        cameras[c, 8],
    )


@wp.func
def camera_vector(cameras: wp.array2d[float], c: int, first: int) -> wp.vec3:
    """Three numbers of a camera's row."""
    return wp.vec3(cameras[c, first], cameras[c, first + 1], cameras[c, first + 2])


@wp.func
def held_slope(slope: float, focal: float, centre: float, size: float) -> float:
    """x/z or y/z, clamped where the Jacobian would linearise too far beside the picture."""
    margin = FIELD_MARGIN * 0.5 * size / focal
    return wp.clamp(slope, -centre / focal - margin, (size - centre) / focal + margin)


@wp.func
def held_slopes(cameras: wp.array2d[float], c: int, point: wp.vec3, width: int, height: int) -> wp.vec2:
    """Both slopes of a point in camera axes, clamped."""
    z = 1.0 / point[2]
    return wp.vec2(
        held_slope(point[0] * z, cameras[c, FOCAL_X], cameras[c, CENTRE_X], float(width)),
        held_slope(point[1] * z, cameras[c, FOCAL_Y], cameras[c, CENTRE_Y], float(height)),
    )


@wp.func
def row_to_picture(axis: wp.vec3, forward: wp.vec3, focal: float, slope: float, inverse_z: float) -> wp.vec3:
    """One row of the Jacobian times the camera's rotation: pixels a world unit."""
    return axis * (focal * inverse_z) - forward * (focal * slope * inverse_z)


@wp.func
def unit_quaternion(q: wp.vec4) -> wp.vec4:
    """`q` of length 1; not a number where it has no direction."""
    return q * (1.0 / wp.sqrt(wp.dot(q, q)))


@wp.func
def rotation(q: wp.vec4) -> wp.mat33:
    """Matrix of a unit quaternion, w x y z."""
    w = q[0]
    x = q[1]
    y = q[2]
    z = q[3]
    return wp.mat33(
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )
