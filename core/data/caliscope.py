"""Recordings of the caliscope calibration program.

camera_array.toml   [cameras.N]: size, matrix, distortions (OpenCV, 5), rotation (matrix or Rodrigues vector),
                    translation; world to camera; ``ignore = true`` leaves a camera out; ``time_offset``, which
                    `streamlod calibrate` adds, is added to its times
cam_N.mp4           one a camera
timestamps.csv      sync_index, cam_id, frame_time in seconds: the n-th row of a camera, in order of sync_index,
                    is the n-th picture of its video; pictures of one sync_index form one instant
"""

from __future__ import annotations

import logging
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from streamlod.core.camera import Camera
from streamlod.core.data.colmap.reader import fitted
from streamlod.core.data.dataset import RawRecording
from streamlod.core.data.files import blaming, number, numbers, read_text
from streamlod.core.data.lens import opencv_camera
from streamlod.core.data.names import in_numeric_order, listed
from streamlod.core.data.timed_videos import paired
from streamlod.core.data.video import probe_video
from streamlod.core.errors import InputError

FILE = "camera_array.toml"
TIMES = "timestamps.csv"
_MAX_OFFSET_S = 86_400
_log = logging.getLogger(__name__)


def read_caliscope(path: Path) -> RawRecording:
    """The recording in `path`.

    Raises:
        InputError: missing or damaged files, or files that do not belong together.
    """
    file = path / FILE
    try:
        tables = tomllib.loads(read_text(file)).get("cameras")
    except (ValueError, RecursionError) as error:  # ValueError also for integers of thousands of digits
        raise InputError(file, f"is not valid TOML: {error}") from error
    if not isinstance(tables, dict) or not all(isinstance(table, dict) for table in tables.values()):
        raise InputError(file, "needs a table [cameras.N] for each camera")
    if not all(key.isascii() and key.isdecimal() for key in tables):
        raise InputError(file, "calls its cameras by other than numbers; tables must be [cameras.0], [cameras.1], ...")
    used = in_numeric_order(key for key, table in tables.items() if not table.get("ignore"))
    unposed = [key for key in used if tables[key].get("rotation") is None or tables[key].get("translation") is None]
    if unposed:
        which = listed(f"cam_{key}" for key in unposed)
        _log.warning("%s: left out, as the calibration did not place them: %s", file, which)
        used = [key for key in used if key not in unposed]
    files = [path / f"cam_{key}.mp4" for key in used]
    with blaming(file):
        cameras = [_camera(f"cam_{key}", tables[key], file) for key in used]
        offsets = np.array([number(tables[key].get("time_offset", 0.0), "time_offset", file) for key in used])
    if not (np.abs(offsets) <= _MAX_OFFSET_S).all():
        raise InputError(file, f"a time_offset is beyond {_MAX_OFFSET_S} seconds")
    infos = [probe_video(video) for video in files]
    fitting = [fitted(camera, (i.width, i.height), f) for camera, i, f in zip(cameras, infos, files, strict=True)]
    return RawRecording(path, "caliscope", tuple(fitting), paired(path / TIMES, used, files, infos, offsets))


def _camera(name: str, table: dict[str, Any], file: Path) -> Camera:
    if table.get("fisheye"):
        raise InputError(f"camera {name}", "a fisheye lens is not supported")
    size = numbers(table.get("size"), (2,), "size", file)
    if not (size.min() >= 1 and size.max() < 1e6):
        raise InputError(f"camera {name}", "picture size is not possible")
    rotation = table.get("rotation")
    if isinstance(rotation, list) and rotation and not isinstance(rotation[0], list):
        matrix = cv2.Rodrigues(numbers(rotation, (3,), "rotation", file))[0]
    else:
        matrix = numbers(rotation, (3, 3), "rotation", file)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = matrix, numbers(table.get("translation"), (3,), "translation", file)
    return opencv_camera(
        name,
        numbers(table.get("matrix"), (3, 3), "matrix", file),
        pose,
        (int(size[0]), int(size[1])),
        numbers(table.get("distortions"), (5,), "distortions", file),
    )
