"""Viewpoints: a camera of the rig, an orbit around what the rig looks at, poses from a file, or a path of the page."""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.camera.view import COUNT, camera_of_view, view_in
from streamlod.core.data.files import read_bytes
from streamlod.core.errors import InputError
from streamlod.core.scene.anchors import SceneHeader

CameraPath = Callable[[int], Camera]  # picture number to camera
_MAX_POSE_FILE_BYTES = 16 << 20
_MAX_SIDE = 8192
_ORBIT_PICTURES = 90  # pictures of one turn if `pictures` is not given
_MAX_FILE_BYTES, _MAX_KEYS, _MAX_SECONDS = 1 << 20, 64, 3600.0
_FORMAT = 1


def camera_named(header: SceneHeader, name: str) -> Camera:
    """The rig's camera `name`; InputError lists those there are."""
    for camera in header.cameras:
        if camera.name == name:
            return camera.undistorted()
    names = ", ".join(camera.name for camera in header.cameras) or "none"
    raise InputError(f"camera {name}", f"the scene does not have it; its cameras are: {names}")


def orbit(header: SceneHeader, pictures: int | None = None) -> CameraPath:
    """One turn on an ellipse inside the rig, looking at the point that its cameras look at.

    Args:
        pictures: number of pictures of a turn.

    Raises:
        InputError: the scene has no cameras, or a turn no picture.
    """
    if pictures is not None and pictures < 1:
        raise InputError("orbit", f"a turn needs a picture or more, not {pictures}")
    if not header.cameras:
        raise InputError("--orbit", "the scene has no cameras to orbit among; give --pose")
    centres = np.stack([camera.centre for camera in header.cameras])
    forwards = np.stack([camera.world_to_camera[2, :3] for camera in header.cameras])
    middle = centres.mean(axis=0)
    focus = focus_point(centres, forwards, header.reference_distance)
    nearest = header.cameras[int(np.linalg.norm(centres - middle, axis=1).argmin())].undistorted()
    down = np.mean([camera.world_to_camera[1, :3] for camera in header.cameras], axis=0)
    reach = max(float(np.linalg.norm(focus - middle)), 1e-6)
    axes = nearest.world_to_camera[:2, :3]
    spread = np.abs((centres - middle) @ axes.T).max(axis=0)
    radii = np.clip(0.6 * spread, 0.05 * reach, 0.5 * reach)
    turn = pictures or _ORBIT_PICTURES

    def at(number: int) -> Camera:
        angle = 2 * math.pi * number / turn
        eye = middle + radii[0] * math.cos(angle) * axes[0] + radii[1] * math.sin(angle) * axes[1]
        return replace(nearest, name="orbit", world_to_camera=look_at(eye, focus, -down))

    return at


def focus_point(centres: Float64, forwards: Float64, fallback_distance: float) -> Float64:
    """[3] point nearest to all optical axes, in the least squares sense.

    Where the axes are parallel, or meet behind the cameras, a point ahead of their middle at `fallback_distance`.
    """
    middle, ahead = centres.mean(axis=0), forwards.mean(axis=0)
    across = np.eye(3) - forwards[:, :, None] * forwards[:, None, :]
    matrix = across.sum(axis=0)
    if np.linalg.cond(matrix) < 1e6:
        point = np.linalg.solve(matrix, (across @ centres[:, :, None]).sum(axis=0)[:, 0])
        if (point - middle) @ ahead > 0:
            return np.asarray(point, np.float64)
    return np.asarray(middle + fallback_distance * ahead / max(float(np.linalg.norm(ahead)), 1e-9), np.float64)


def read_poses(path: Path, header: SceneHeader) -> CameraPath:
    """Cameras of a JSON file; the last one is kept when there are more pictures than poses.

    The file holds one object or a list of them: ``{"world_to_camera": 3x4 or 4x4 rows, "width": W, "height": H,
    "focal": [fx, fy], "principal": [cx, cy]}``. Only the pose is required; the rest defaults to the first camera.

    Raises:
        InputError: the file cannot be read, or does not have this form.
    """
    value = _read_json(path, _MAX_POSE_FILE_BYTES)
    entries = value if isinstance(value, list) else [value]
    cameras = [_pose(path, number, entry, header) for number, entry in enumerate(entries)]
    if not cameras:
        raise InputError(path, "holds no pose")
    return lambda number: cameras[min(number, len(cameras) - 1)]


def _read_json(path: Path, most: int) -> Any:
    """The JSON value in a file of at most `most` bytes; InputError where there is none."""
    data = read_bytes(path, most)
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"is not JSON ({error})") from error


def _pose(path: Path, number: int, entry: Any, header: SceneHeader) -> Camera:
    if not isinstance(entry, dict) or "world_to_camera" not in entry:
        raise InputError(path, f"pose {number} has no world_to_camera")
    if not header.cameras and not {"width", "height", "focal"} <= entry.keys():
        raise InputError(path, f"pose {number} needs width, height and focal, because the scene has no camera")
    model = header.cameras[0] if header.cameras else None
    try:
        width = int(entry.get("width", model.width if model else 0))
        height = int(entry.get("height", model.height if model else 0))
        if not (0 < width <= _MAX_SIDE and 0 < height <= _MAX_SIDE):
            raise InputError(path, f"pose {number}: picture size {width}x{height} is not between 1 and {_MAX_SIDE}")
        scaled = model.scaled(width, height).intrinsics if model else np.eye(3)
        focal = np.asarray(entry.get("focal", (scaled[0, 0], scaled[1, 1])), np.float64).reshape(2)
        centre = (scaled[0, 2], scaled[1, 2]) if model else (width / 2, height / 2)
        principal = np.asarray(entry.get("principal", centre), np.float64).reshape(2)
        pose = np.asarray(entry["world_to_camera"], np.float64)
        if pose.shape not in {(3, 4), (4, 4)}:
            raise InputError(path, f"pose {number}: world_to_camera must be 3x4 or 4x4")
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(path, f"pose {number}: {error}") from error
    try:
        return pinhole("pose", (focal[0], focal[1]), (principal[0], principal[1]), (width, height), pose)
    except InputError as error:
        raise InputError(path, f"pose {number}: {error.fault}") from error


@dataclass(frozen=True, slots=True, eq=False)
class CameraRoute:
    """Viewpoints in time.

    Attributes:
        seconds: [K] ascending.
        values: [K,14] as `core.camera.view` has them.
        loops: whether it begins again at its end.
    """

    seconds: Float64
    values: Float64
    loops: bool

    @property
    def length(self) -> float:
        """Seconds from the first viewpoint to the last."""
        return float(self.seconds[-1])

    def at(self, seconds: float, size: tuple[int, int]) -> Camera:
        """The camera at a time, of a picture of `size` (width, height): cubic Hermite, each slope that between the
        neighbours (Catmull and Rom, with times), directions made orthonormal again."""
        between = camera_of_view("path", self.values_at(seconds), size)
        camera = between or camera_of_view("path", self.values[0], size)
        assert camera is not None, "every viewpoint of a path was checked"
        return camera

    def values_at(self, seconds: float) -> Float64:
        """[14] between the viewpoints."""
        times, values, last = self.seconds, self.values, len(self.seconds) - 1
        if last == 0:
            return np.asarray(values[0], np.float64)
        time = seconds % self.length if self.loops else min(max(seconds, 0.0), self.length)
        i = min(max(bisect_right(times.tolist(), time) - 1, 0), last - 1)
        span = times[i + 1] - times[i]
        s = (time - times[i]) / span

        def slope(k: int) -> Float64:
            a, b = max(0, k - 1), min(last, k + 1)
            return np.asarray(span * (values[b] - values[a]) / (times[b] - times[a]), np.float64)

        ends = (2 * s**3 - 3 * s**2 + 1) * values[i] + (3 * s**2 - 2 * s**3) * values[i + 1]
        return np.asarray(ends + (s**3 - 2 * s**2 + s) * slope(i) + (s**3 - s**2) * slope(i + 1), np.float64)


def read_path(file: Path) -> CameraRoute:
    """A path as the page saves it.

    Raises:
        InputError: the file cannot be read, or holds no such path.
    """
    told = _read_json(file, _MAX_FILE_BYTES)
    keys = told.get("keys") if isinstance(told, dict) and told.get("version") == _FORMAT else None
    if not isinstance(keys, list) or not 1 <= len(keys) <= _MAX_KEYS:
        raise InputError(file, f"is no camera path: the page's panel of paths saves one, with up to {_MAX_KEYS} keys")
    seconds: list[float] = []
    values = []
    for number, key in enumerate(keys, 1):
        text, time = key.get("camera") if isinstance(key, dict) else None, _time(key)
        numbers = view_in(text) if isinstance(text, str) else None
        if numbers is None or numbers[9] <= 0 or camera_of_view("path", numbers, (2, 2)) is None:
            raise InputError(file, f"viewpoint {number} has no camera of {COUNT} numbers")
        if time is None or (seconds and time <= seconds[-1]):
            raise InputError(file, f"viewpoint {number}: its time must be later than that of the one before")
        seconds.append(time)
        values.append(numbers)
    return CameraRoute(np.array(seconds), np.stack(values), told.get("loops") is True)


def _time(key: Any) -> float | None:
    value = key.get("seconds") if isinstance(key, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= _MAX_SECONDS:
        return None  # also what is not a number
    return float(value)


def along(path: CameraRoute, size: tuple[int, int], fps: float) -> Callable[[int], Camera]:
    """Picture number to camera, at `fps` pictures a second."""
    return lambda number: path.at(number / fps, size)
