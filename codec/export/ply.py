"""PLY in the layout of the original 3D Gaussian splatting code.

Degree-0 colour, logit opacity, log scales, wxyz rotation.
Axes are those of the scene (OpenCV: y down), which is what splat viewers expect of a .ply.
"""

from __future__ import annotations

import numpy as np

from streamlod.core.arrays import Float32
from streamlod.core.scene.gaussians import GaussianCloud

SH_C0 = 0.28209479177387814  # Y_00, so that colour = 0.5 + SH_C0 * f_dc
_PROPERTIES = (
    *("x", "y", "z", "nx", "ny", "nz"),
    *("f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2"),
    *("rot_0", "rot_1", "rot_2", "rot_3"),
)
_MIN_OPACITY = 1e-6
_MIN_SCALE = 1e-12


def encode_ply(cloud: GaussianCloud, comment: str) -> bytes:
    """The file's bytes; `comment` is one line that says where the Gaussians come from.

    Raises:
        ValueError: a comment of several lines, or one that is not ASCII.
    """
    if not comment.isascii() or not comment.isprintable():
        raise ValueError("a PLY comment is one line of ASCII")
    opacity = np.clip(cloud.opacities.astype(np.float64), _MIN_OPACITY, 1 - _MIN_OPACITY)[:, None]
    columns = (
        cloud.means,
        np.zeros_like(cloud.means),
        (cloud.colours - 0.5) / SH_C0,
        np.log(opacity / (1 - opacity)),
        np.log(np.maximum(cloud.scales, _MIN_SCALE)),
        unit_quaternions(cloud.quaternions),
    )
    lines = ["ply", "format binary_little_endian 1.0", f"comment {comment}", f"element vertex {len(cloud)}"]
    lines += [f"property float {name}" for name in _PROPERTIES]
    header = "\n".join([*lines, "end_header", ""]).encode("ascii")
    return header + np.concatenate(columns, axis=1).astype("<f4").tobytes()


def unit_quaternions(quaternions: Float32) -> Float32:
    """[G,4] of unit length; a quaternion of no length becomes the identity."""
    wide = quaternions.astype(np.float64)  # whose squares of any float32 are finite
    length = np.linalg.norm(wide, axis=1, keepdims=True)
    return np.where(length > 1e-12, wide / np.maximum(length, 1e-12), np.array([1, 0, 0, 0])).astype(np.float32)
