"""The content of COLMAP's files, in binary and in text alike."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.errors import InputError

MODEL_NAMES = {
    **{0: "SIMPLE_PINHOLE", 1: "PINHOLE", 2: "SIMPLE_RADIAL", 3: "RADIAL", 4: "OPENCV"},
    **{5: "OPENCV_FISHEYE", 6: "FULL_OPENCV", 7: "FOV", 8: "SIMPLE_RADIAL_FISHEYE", 9: "RADIAL_FISHEYE"},
}
_PARAMETERS = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "FULL_OPENCV": 12}
_QUATERNION_TOLERANCE = 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class ColmapCamera:
    """A lens and sensor: model name, size in pixels and the model's parameters."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]

    def intrinsics(self) -> tuple[Float64, Float64]:
        """[3,3] intrinsics and [5] OpenCV distortion of the model; InputError for coefficients beyond these five."""
        values = self.parameters
        if any(values[9:]):  # of FULL_OPENCV
            raise InputError("camera model FULL_OPENCV", "has k4, k5 or k6, which are not supported; undistort first")
        if self.model in ("PINHOLE", "OPENCV", "FULL_OPENCV"):
            (fx, fy, cx, cy), rest = values[:4], values[4:]
        else:
            (fx, cx, cy), rest = values[:3], values[3:]
            fy = fx
        distortion = np.zeros(5)
        distortion[: len(rest[:5])] = rest[:5]  # k1 | k1 k2 | k1 k2 p1 p2 | k1 k2 p1 p2 k3 (k4 k5 k6)
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64), distortion


@dataclass(frozen=True, slots=True, eq=False)
class ColmapImage:
    """A registered picture: file name, camera number and [4,4] world_to_camera."""

    name: str
    camera_id: int
    world_to_camera: Float64


def parameter_count(path: Path, model: str) -> int:
    """Number of parameters of a camera model; InputError for models that are not supported."""
    if model not in _PARAMETERS:
        known = ", ".join(_PARAMETERS)
        raise InputError(path, f"camera model {model} is not supported ({known} are); undistort with COLMAP first")
    return _PARAMETERS[model]


def colmap_image(
    path: Path, name: str, camera_id: int, quaternion: tuple[float, ...], translation: tuple[float, ...]
) -> ColmapImage:
    """The image with the pose of a unit quaternion (w x y z) and translation.

    Raises:
        InputError: no rotation, or a name that no file can have.
    """
    if not name or "\0" in name:
        raise InputError(path, f"image {camera_id} has a name that no file can have")
    length = math.hypot(*quaternion)
    if not abs(length - 1) < _QUATERNION_TOLERANCE:
        raise InputError(path, f"image {name}: its quaternion has length {length:.3g}, which is no rotation")
    w, x, y, z = np.asarray(quaternion) / length
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = translation
    return ColmapImage(name, camera_id, pose)
