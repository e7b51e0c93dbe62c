"""The projection's pieces that forward and backward share (Zwicker et al., EWA splatting, 2002, section 4)."""

from __future__ import annotations

from typing import Any

from numba import njit

from streamlod.core.arrays import Float32
from streamlod.core.render.cpu.kernels.inline.constants import (
    CENTRE_X,
    CENTRE_Y,
    FIELD_MARGIN,
    FOCAL_X,
    FOCAL_Y,
    HALF,
    INLINE,
    ONE,
    TWO,
)


@njit(**INLINE)
def clamp(value: Any, low: Any, high: Any) -> Any:
    return min(max(value, low), high)


@njit(**INLINE)
def to_camera(camera: Float32, x: Any, y: Any, z: Any) -> Any:
    """World point to camera axes."""
    return (
        camera[0] * x + camera[1] * y + camera[2] * z + camera[9],
        camera[3] * x + camera[4] * y + camera[5] * z + camera[10],
        camera[6] * x + camera[7] * y + camera[8] * z + camera[11],
    )


@njit(**INLINE)
def slope_limits(camera: Float32, width: Any, height: Any) -> Any:
    """Where x/z and y/z are clamped for the Jacobian: low and high of x, then of y."""
    margin_x, margin_y = FIELD_MARGIN * HALF * width / camera[FOCAL_X], FIELD_MARGIN * HALF * height / camera[FOCAL_Y]
    left, right = camera[CENTRE_X] / camera[FOCAL_X], (width - camera[CENTRE_X]) / camera[FOCAL_X]
    top, bottom = camera[CENTRE_Y] / camera[FOCAL_Y], (height - camera[CENTRE_Y]) / camera[FOCAL_Y]
    return -left - margin_x, right + margin_x, -top - margin_y, bottom + margin_y


@njit(**INLINE)
def rotation(w: Any, x: Any, y: Any, z: Any) -> Any:
    """Matrix of a unit quaternion, row by row."""
    return (
        ONE - TWO * (y * y + z * z),
        TWO * (x * y - w * z),
        TWO * (x * z + w * y),
        TWO * (x * y + w * z),
        ONE - TWO * (x * x + z * z),
        TWO * (y * z - w * x),
        TWO * (x * z - w * y),
        TWO * (y * z + w * x),
        ONE - TWO * (x * x + y * y),
    )


@njit(**INLINE)
def world_to_picture(camera: Float32, inverse_z: Any, slope_x: Any, slope_y: Any) -> Any:
    """Jacobian of the projection times the camera's rotation: two rows of three, pixels a world unit."""
    ax, bx = camera[FOCAL_X] * inverse_z, -camera[FOCAL_X] * slope_x * inverse_z
    ay, by = camera[FOCAL_Y] * inverse_z, -camera[FOCAL_Y] * slope_y * inverse_z
    return (
        ax * camera[0] + bx * camera[6],
        ax * camera[1] + bx * camera[7],
        ax * camera[2] + bx * camera[8],
        ay * camera[3] + by * camera[6],
        ay * camera[4] + by * camera[7],
        ay * camera[5] + by * camera[8],
    )


@njit(**INLINE)
def times_matrix(t0: Any, t1: Any, t2: Any, m: Any) -> Any:
    """Row vector times 3x3 matrix (nine numbers)."""
    return (
        t0 * m[0] + t1 * m[3] + t2 * m[6],
        t0 * m[1] + t1 * m[4] + t2 * m[7],
        t0 * m[2] + t1 * m[5] + t2 * m[8],
    )
