"""A calibrated camera.

Conventions, everywhere in streamlod: OpenCV axes (x right, y down, z forward), world_to_camera maps world points into
them, pixel centres lie at half-integers, so that the image spans [0, width] x [0, height].
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from streamlod.core.arrays import Float64, check_array
from streamlod.core.errors import InputError

COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")  # of distortion, as OpenCV orders them
_ROTATION_TOLERANCE = 1e-3
_NO_DISTORTION = np.zeros(5)
_MAX_NUMBER = 1e12  # larger numbers come from damage, and their products overflow


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """One camera's geometry.

    Attributes:
        name: as in the data set, for example ``cam00``.
        intrinsics: [3,3] float64, focal lengths and principal point in pixels.
        world_to_camera: [4,4] float64 rigid transform.
        width: of pictures, in pixels.
        height: of pictures, in pixels.
        distortion: [5] float64 OpenCV k1 k2 p1 p2 k3; zeros for a pinhole.

    Raises:
        InputError: numbers that are not finite or absurdly large, a rotation that is not one, a focal length or size
            that is not positive, a size that is not in whole pixels.
    """

    name: str
    intrinsics: Float64
    world_to_camera: Float64
    width: int
    height: int
    distortion: Float64

    def __post_init__(self) -> None:
        check_array("intrinsics", self.intrinsics, (3, 3), np.float64)
        check_array("world_to_camera", self.world_to_camera, (4, 4), np.float64)
        check_array("distortion", self.distortion, (5,), np.float64)
        for label, array in (
            ("intrinsics", self.intrinsics),
            ("pose", self.world_to_camera),
            ("distortion", self.distortion),
        ):
            if not np.isfinite(array).all():
                raise InputError(f"camera {self.name}", f"its {label} holds numbers that are not finite")
            if np.abs(array).max() > _MAX_NUMBER:
                raise InputError(f"camera {self.name}", f"its {label} holds numbers beyond {_MAX_NUMBER:g}")
        if not isinstance(self.width, int | np.integer) or not isinstance(self.height, int | np.integer):
            raise InputError(f"camera {self.name}", f"picture size {self.width}x{self.height} is not in whole pixels")
        if self.width < 1 or self.height < 1:
            raise InputError(f"camera {self.name}", f"picture size {self.width}x{self.height} is not positive")
        if self.intrinsics[0, 0] <= 0 or self.intrinsics[1, 1] <= 0:
            raise InputError(f"camera {self.name}", "focal length must be positive")
        rotation = self.world_to_camera[:3, :3]
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > _ROTATION_TOLERANCE:
            raise InputError(f"camera {self.name}", "its pose does not hold a rotation")
        if np.linalg.det(rotation) < 0:
            raise InputError(f"camera {self.name}", "its pose is mirrored: one axis points the other way")

    @property
    def centre(self) -> Float64:
        """[3] camera centre in world units."""
        rotation, translation = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        return np.asarray(-rotation.T @ translation, np.float64)

    @property
    def has_distortion(self) -> bool:
        """Whether pictures of this camera need undistorting before use."""
        return bool(np.any(self.distortion != 0))

    def scaled(self, width: int, height: int) -> Camera:
        """The same camera after its pictures were resampled to `width` x `height`."""
        factor = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, intrinsics=factor @ self.intrinsics, width=width, height=height)

    def turned(self) -> Camera:
        """The same pinhole after its pictures were turned a quarter to the left, as `numpy.rot90` does."""
        (fx, _, cx), (_, fy, cy), _ = self.intrinsics
        intrinsics = np.array([[fy, 0, cy], [0, fx, self.width - cx], [0, 0, 1]])
        pose = self.world_to_camera[[1, 0, 2, 3]] * np.array([[1.0], [-1.0], [1.0], [1.0]]) + 0.0  # no zero is negative
        return replace(self, intrinsics=intrinsics, world_to_camera=pose, width=self.height, height=self.width)

    def undistorted(self) -> Camera:
        """The pinhole camera with the same intrinsics."""
        return replace(self, distortion=_NO_DISTORTION.copy())


def pinhole(
    name: str, focal: tuple[float, float], principal: tuple[float, float], size: tuple[int, int], pose: Float64
) -> Camera:
    """A camera without distortion.

    Args:
        focal: (fx, fy) in pixels.
        principal: (cx, cy) in pixels.
        size: (width, height) in pixels.
        pose: [4,4] or [3,4] world_to_camera.
    """
    world_to_camera = np.eye(4)
    world_to_camera[:3] = np.asarray(pose, np.float64)[:3]
    intrinsics = np.array([[focal[0], 0, principal[0]], [0, focal[1], principal[1]], [0, 0, 1]], np.float64)
    return Camera(name, intrinsics, world_to_camera, int(size[0]), int(size[1]), _NO_DISTORTION.copy())


def look_at(eye: Float64, target: Float64, up: Float64) -> Float64:
    """[4,4] world_to_camera of a camera at `eye` that looks at `target`, with `up` pointing to the picture's top.

    Raises:
        ValueError: eye and target coincide, or up is parallel to the line of sight.
    """
    forward = np.asarray(target, np.float64) - np.asarray(eye, np.float64)
    right = np.cross(forward, np.asarray(up, np.float64))
    if np.linalg.norm(forward) < 1e-12 or np.linalg.norm(right) < 1e-12:
        raise ValueError("look_at needs a target away from the eye and an up that is not along the line of sight")
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = rotation, -rotation @ np.asarray(eye, np.float64)
    return world_to_camera
