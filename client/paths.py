"""Camera paths of the page's panel (client/web/view/path.js): viewpoints with times, and the camera between them."""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera, pinhole
from streamlod.core.errors import InputError

_MAX_FILE_BYTES, _MAX_KEYS, _MAX_SECONDS = 1_000_000, 64, 3600.0
_NUMBERS = 14  # of a camera's text: position, forward, down, distance, focal length, principal point, stretch
_FORMAT = 1


@dataclass(frozen=True, slots=True, eq=False)
class CameraRoute:
    """Viewpoints in time.

    Attributes:
        seconds: [K] ascending.
        values: [K,14] as the page's `state.camera` lists them: position, forward and down directions (3 each, world
            units), distance to what is looked at, focal length and principal point as fractions of the picture's
            height, and the horizontal focal length over the vertical one.
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
        return _camera(self.values_at(seconds), size) or _camera(self.values[0], size) or _unreachable()

    def values_at(self, seconds: float) -> Float64:
        """[14] between the viewpoints."""
        times, values, last = self.seconds, self.values, len(self.seconds) - 1
        if last == 0:
            return values[0]
        time = seconds % self.length if self.loops else min(max(seconds, 0.0), self.length)
        i = min(max(bisect_right(times.tolist(), time) - 1, 0), last - 1)
        span = times[i + 1] - times[i]
        s = (time - times[i]) / span

        def slope(k: int) -> Float64:
            a, b = max(0, k - 1), min(last, k + 1)
            return np.asarray(span * (values[b] - values[a]) / (times[b] - times[a]), np.float64)

        ends = (2 * s**3 - 3 * s**2 + 1) * values[i] + (3 * s**2 - 2 * s**3) * values[i + 1]
        return np.asarray(ends + (s**3 - 2 * s**2 + s) * slope(i) + (s**3 - s**2) * slope(i + 1), np.float64)


def _unreachable() -> Camera:
    raise AssertionError("every viewpoint of a path was checked")


def _camera(values: Float64, size: tuple[int, int]) -> Camera | None:
    """None where the numbers are no camera."""
    (width, height), (focal, right_shift, down_shift, stretch) = size, values[10:]
    if not np.all(np.isfinite(values)) or not (values[9] > 0 and focal > 0 and stretch > 0):
        return None
    across = np.cross(values[6:9], values[3:6])
    if np.linalg.norm(across) < 1e-3:
        return None
    forward, right = values[3:6] / np.linalg.norm(values[3:6]), across / np.linalg.norm(across)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.concatenate([rotation, (-rotation @ values[:3])[:, None]], axis=1)
    principal = width / 2 + right_shift * height, height / 2 + down_shift * height
    return pinhole("path", (focal * stretch * height, focal * height), principal, size, pose)


def read_path(file: Path) -> CameraRoute:
    """A path as the page saves it.

    Raises:
        InputError: the file cannot be read, or holds no such path.
    """
    try:
        if file.stat().st_size > _MAX_FILE_BYTES:
            raise InputError(file, f"is larger than {_MAX_FILE_BYTES // 1_000_000} MB")
        told = json.loads(file.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror})") from error
    except (ValueError, RecursionError) as error:
        raise InputError(file, f"is not JSON ({error})") from error
    keys = told.get("keys") if isinstance(told, dict) and told.get("version") == _FORMAT else None
    if not isinstance(keys, list) or not 1 <= len(keys) <= _MAX_KEYS:
        raise InputError(file, f"is no camera path: the page's panel of paths saves one, with up to {_MAX_KEYS} keys")
    seconds: list[float] = []
    values = []
    for number, key in enumerate(keys, 1):
        numbers = _numbers(key)
        time = key.get("seconds") if isinstance(key, dict) else None
        if numbers is None or _camera(numbers, (2, 2)) is None:
            raise InputError(file, f"viewpoint {number} has no camera of {_NUMBERS} numbers")
        if not _is_time(time) or (seconds and time <= seconds[-1]):
            raise InputError(file, f"viewpoint {number}: its time must be later than that of the one before")
        seconds.append(float(time))
        values.append(numbers)
    return CameraRoute(np.array(seconds), np.stack(values), told.get("loops") is True)


def _is_time(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and math.isfinite(value) and 0 <= value <= _MAX_SECONDS


def _numbers(key: Any) -> Float64 | None:
    text = key.get("camera") if isinstance(key, dict) else None
    if not isinstance(text, str) or len(text) > 1000:
        return None
    try:
        numbers = np.array([float(part) for part in text.split(",")])
    except ValueError:
        return None
    return numbers if len(numbers) == _NUMBERS else None


def along(path: CameraRoute, size: tuple[int, int], fps: float) -> Callable[[int], Camera]:
    """Picture number to camera, at `fps` pictures a second."""
    return lambda number: path.at(number / fps, size)
