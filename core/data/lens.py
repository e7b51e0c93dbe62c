"""Pictures as a lens took them -> pictures of a pinhole camera, at the size wanted.

OpenCV puts pixel centres on integers and `Camera` on half-integers, hence the halves that come and go here.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from streamlod.core.arrays import Float64, UInt8
from streamlod.core.camera import Camera
from streamlod.core.errors import InputError

_log = logging.getLogger(__name__)
_BORDER_SAMPLES = 65
_SHAPE_TOLERANCE = 0.01  # of width against height
_MIN_FOCAL = 0.05  # of a picture's longer side; no pinhole sees 169 degrees
_MAX_PRINCIPAL = 5.0  # longer sides from the picture's middle
_MAX_ZOOM = 4.0  # a lens that needs more than this to fill a picture is not described by five coefficients
_ITERATIONS = 30
_SETTLED = 1e-14  # on the plane z = 1: as exact as numbers are
_ROUND_TRIP = 1e-6  # on the plane z = 1, far below a pixel


def opencv_camera(
    name: str, matrix: Float64, pose: Float64, size: tuple[int, int], distortion: Float64 | None = None
) -> Camera:
    """A camera from numbers in OpenCV's convention, where the top left pixel's centre is (0, 0).

    Args:
        matrix: [3,3] intrinsics; pose: [4,4] world_to_camera; size: (width, height); distortion: [5] or none.
    """
    intrinsics = np.array(matrix, np.float64)
    intrinsics[:2, 2] += 0.5
    return Camera(name, intrinsics, pose, size[0], size[1], np.zeros(5) if distortion is None else distortion)


def opencv_matrix(camera: Camera) -> Float64:
    """[3,3] intrinsics of `camera` in OpenCV's convention; the inverse of what `opencv_camera` does."""
    matrix = camera.intrinsics.copy()
    matrix[:2, 2] -= 0.5
    return matrix


def undistorted_camera(camera: Camera) -> Camera:
    """The pinhole camera that pictures of `camera` are turned into: same size and principal point, no empty pixel.

    Both focal lengths are multiplied by the smallest factor with which every pixel of the result was seen.

    Raises:
        InputError: distortion so strong that no such picture exists.
    """
    if not camera.has_distortion:
        return camera
    width, height = camera.width, camera.height
    across, down = np.linspace(0, width, _BORDER_SAMPLES), np.linspace(0, height, _BORDER_SAMPLES)
    sides = [  # the picture's outline: axis whose coordinate is constant, and the points
        (0, np.stack([np.zeros_like(down), down], 1)),
        (0, np.stack([np.full_like(down, width), down], 1)),
        (1, np.stack([across, np.zeros_like(across)], 1)),
        (1, np.stack([across, np.full_like(across, height)], 1)),
    ]
    focal, principal = camera.intrinsics[[0, 1], [0, 1]], camera.intrinsics[:2, 2]
    factor = 0.0
    for axis, points in sides:
        with np.errstate(over="ignore"):
            seen = (points - principal) / focal
        ideal = undistort(seen, camera.distortion)
        wanted = seen[0, axis]
        nearest = ideal[np.abs(ideal[:, axis]).argmin(), axis]
        if not np.isfinite(nearest) or wanted * nearest <= 0:
            raise InputError(f"camera {camera.name}", "its distortion cannot be undone; check the coefficients")
        factor = max(factor, wanted / nearest)
    if not 1 / _MAX_ZOOM < factor < _MAX_ZOOM:
        raise InputError(f"camera {camera.name}", "its distortion is too strong to be undone; check the coefficients")
    intrinsics = camera.intrinsics.copy()
    intrinsics[[0, 1], [0, 1]] *= factor
    return replace(camera, intrinsics=intrinsics).undistorted()


def scaled_size(width: int, height: int, downscale: float) -> tuple[int, int]:
    """(width, height) after scaling down: 2704x2028 by 2 is 1352x1014; fractions are cut, and 1 stays 1."""
    return max(1, int(width / downscale)), max(1, int(height / downscale))


@dataclass(frozen=True, slots=True, eq=False)
class Undistortion:
    """A plan that turns one camera's raw pictures into those of its pinhole camera.

    Attributes:
        lens: the camera of the pictures that come in.
        upright: the pinhole camera of the pictures before they are turned.
        maps: OpenCV fixed-point sampling maps, or none without distortion.
        is_turned: whether pictures are turned a quarter, to lie like those of other cameras.
    """

    lens: Camera
    upright: Camera
    maps: tuple[NDArray[Any], NDArray[Any]] | None
    is_turned: bool = False

    @property
    def camera(self) -> Camera:
        """The pinhole camera of the pictures that go out."""
        return self.upright.turned() if self.is_turned else self.upright

    def __call__(self, picture: UInt8) -> UInt8:
        """[H,W,3] raw picture -> [camera.height,camera.width,3]: undistorted, averaged by area, turned."""
        straight: NDArray[Any] = picture
        if self.maps is not None:
            straight = cv2.remap(picture, *self.maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        size = self.upright.width, self.upright.height
        if size != (self.lens.width, self.lens.height):
            straight = cv2.resize(straight, size, interpolation=cv2.INTER_AREA)
        return np.rot90(straight) if self.is_turned else straight

    def as_by(self, other: Undistortion, points: Float64) -> Float64:
        """[N,2] pixels in which `other` shows what this plan shows at `points` [N,2] of one raw picture.

        NaN where the other's lens shows no ray.
        """
        if self.is_turned:
            points = np.stack([self.upright.width - points[:, 1], points[:, 0]], axis=1)
        seen = _pixels(self.lens, distort(_rays(self.upright, points), self.lens.distortion))
        found = _pixels(other.upright, undistort(_rays(other.lens, seen), other.lens.distortion))
        return np.stack([found[:, 1], other.upright.width - found[:, 0]], axis=1) if other.is_turned else found


def _rays(camera: Camera, pixels: Float64) -> Float64:
    """[N,2] points on the plane z = 1, without distortion."""
    return np.asarray((pixels - camera.intrinsics[:2, 2]) / camera.intrinsics[[0, 1], [0, 1]], np.float64)


def _pixels(camera: Camera, rays: Float64) -> Float64:
    """The inverse of `_rays`."""
    return np.asarray(rays * camera.intrinsics[[0, 1], [0, 1]] + camera.intrinsics[:2, 2], np.float64)


def undistortions(cameras: Sequence[Camera], downscale: float) -> tuple[Undistortion, ...]:
    """A plan for each camera; all pictures get one size, which is that of the smallest, scaled down.

    Upright pictures among ones that lie, and the other way round, are turned to be like those of the first camera.

    Raises:
        InputError: pictures of different shapes, intrinsics that are none in pixels, or a distortion that cannot be
            undone.
    """
    first, smallest = cameras[0], min(cameras, key=lambda camera: camera.width * camera.height)
    turned = [not _have_one_shape(camera, first.width, first.height) for camera in cameras]
    for camera, is_turned in zip(cameras, turned, strict=True):
        if is_turned and not _have_one_shape(camera, first.height, first.width):
            raise InputError(
                f"camera {camera.name}",
                f"has pictures of {camera.width}x{camera.height}, but {first.name} of {first.width}x{first.height}; "
                "crop them to one shape",
            )
        _check_intrinsics(camera)
    size = scaled_size(smallest.width, smallest.height, downscale)
    if turned[cameras.index(smallest)]:
        size = size[::-1]
    if len({(max(camera.width, camera.height), min(camera.width, camera.height)) for camera in cameras}) > 1:
        _log.warning("the cameras' pictures have several sizes; all are scaled to %dx%d", *size)
    return tuple(
        replace(undistortion(camera, size[::-1]), is_turned=True) if is_turned else undistortion(camera, size)
        for camera, is_turned in zip(cameras, turned, strict=True)
    )


def _have_one_shape(camera: Camera, width: int, height: int) -> bool:
    return abs(camera.width * height / (camera.height * width) - 1) <= _SHAPE_TOLERANCE


def _check_intrinsics(camera: Camera) -> None:
    """Refuse numbers in other units than pixels, such as shares of the width or millimetres."""
    side, middle = max(camera.width, camera.height), np.array([camera.width, camera.height]) / 2
    focal, principal = camera.intrinsics[[0, 1], [0, 1]], camera.intrinsics[:2, 2]
    fault = None
    if focal.min() < _MIN_FOCAL * side:
        fault = f"focal length is {focal.min():g}"
    elif np.abs(principal - middle).max() > _MAX_PRINCIPAL * side:
        fault = f"principal point is {principal[0]:g}, {principal[1]:g}"
    if fault is not None:
        size = f"{camera.width}x{camera.height}"
        raise InputError(f"camera {camera.name}", f"its {fault} for pictures of {size}; give it in pixels")


def undistortion(camera: Camera, size: tuple[int, int]) -> Undistortion:
    """Plan for pictures of `size` by `camera`, whose own size and intrinsics are those of the raw pictures.

    The maps are computed here, once.
    """
    straight = undistorted_camera(camera)
    maps = None
    if camera.has_distortion:
        maps = cv2.initUndistortRectifyMap(
            opencv_matrix(camera),
            camera.distortion,
            np.eye(3),
            opencv_matrix(straight),
            (camera.width, camera.height),
            cv2.CV_16SC2,
        )
    return Undistortion(camera, straight.scaled(*size), maps)


def distort(points: Float64, coefficients: Float64) -> Float64:
    """[N,2] points on the plane z = 1 -> where a lens with OpenCV's `coefficients` [5] k1 k2 p1 p2 k3 shows them.

    Formula: https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html; `undistort` goes back.
    """
    k1, k2, p1, p2, k3 = coefficients
    x, y = points.T
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=1,
    )


def undistort(points: Float64, coefficients: Float64) -> Float64:
    """The inverse of `distort`, by Newton's method; NaN where the lens shows no ray, or shows it twice."""
    ideal = points.copy()
    if not coefficients.any():
        return ideal
    with np.errstate(all="ignore"):
        for _ in range(_ITERATIONS):
            miss = points - distort(ideal, coefficients)
            if np.abs(miss).max(initial=0) < _SETTLED:
                break
            a, b, d = _slopes(ideal, coefficients)
            steps = np.stack([d * miss[:, 0] - b * miss[:, 1], a * miss[:, 1] - b * miss[:, 0]], axis=1)
            ideal = ideal + steps / (a * d - b * b)[:, None]
        found = np.abs(distort(ideal, coefficients) - points).max(axis=1) < _ROUND_TRIP
        a, b, d = _slopes(ideal, coefficients)
        # both slopes positive: on the near side of the circle at which a barrel lens folds back
        return np.where((found & (a * d > b * b) & (a + d > 0))[:, None], ideal, np.nan)


def _slopes(points: Float64, coefficients: Float64) -> tuple[Float64, Float64, Float64]:
    """The derivative of `distort` at each point, a symmetric matrix (a b; b d)."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = points.T
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    slope = 2 * (k1 + square * (2 * k2 + square * 3 * k3))
    b = x * y * slope + 2 * p1 * x + 2 * p2 * y
    return radial + x * x * slope + 2 * p1 * y + 6 * p2 * x, b, radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
