"""Recordings of the caliscope calibration program.

camera_array.toml   [cameras.N]: size, matrix, distortions (OpenCV, 5), rotation (matrix or Rodrigues vector),
                    translation; world to camera; ``ignore = true`` leaves a camera out
cam_N.mp4           one a camera
timestamps.csv      sync_index, cam_id, frame_time in seconds: the n-th row of a camera, in order of sync_index,
                    is the n-th picture of its video; pictures of one sync_index form one instant
"""

from __future__ import annotations

import csv
import logging
import tomllib
from collections import defaultdict
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera
from streamlod.core.data.colmap.reader import fitted
from streamlod.core.data.dataset import Film, RawRecording
from streamlod.core.data.files import blaming, numbers, read_text
from streamlod.core.data.lens import opencv_camera
from streamlod.core.data.names import in_numeric_order, listed
from streamlod.core.data.sources import shown
from streamlod.core.data.video import VideoInfo, probe_video, read_video
from streamlod.core.errors import InputError

FILE = "camera_array.toml"
TIMES = "timestamps.csv"
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class TimedVideos:
    """Videos whose pictures are paired by a table.

    Attributes:
        files: one a camera.
        times_ns: mean capture time of each instant, from the first one's.
        taken_ns: for each camera, its picture's time in its file at each instant; None where it has none.
        fps: instants a second, from the median interval.
    """

    files: tuple[Path, ...]
    times_ns: tuple[int, ...]
    taken_ns: tuple[tuple[int | None, ...], ...]
    fps: float

    @property
    def frame_count(self) -> int:
        """Number of instants."""
        return len(self.times_ns)

    def time_ns(self, index: int) -> int:
        """Capture time from the clip's start."""
        return self.times_ns[index]

    def pictures(self, camera: int, start: int, stop: int) -> Generator[UInt8 | None, None, None]:
        """Yield pictures; see `Source.pictures`."""
        taken = self.taken_ns[camera][start:stop]
        with closing(read_video(self.files[camera])) as pictures:
            found = shown(self.files[camera], pictures, [time_ns for time_ns in taken if time_ns is not None])
            for time_ns in taken:
                yield None if time_ns is None else next(found)

    def film(self, camera: int) -> Film | None:
        """The camera's file; see `Source.film`."""
        pairs = zip(self.taken_ns[camera], self.times_ns, strict=True)
        begin = next((taken_ns - time_ns for taken_ns, time_ns in pairs if taken_ns is not None), None)
        return None if begin is None else Film(self.files[camera], begin)


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
    infos = [probe_video(video) for video in files]
    fitting = [fitted(camera, (i.width, i.height), f) for camera, i, f in zip(cameras, infos, files, strict=True)]
    return RawRecording(path, "caliscope", tuple(fitting), _paired(path / TIMES, used, files, infos))


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


def _paired(path: Path, keys: list[str], files: list[Path], infos: list[VideoInfo]) -> TimedVideos:
    times: dict[int, dict[str, float]] = defaultdict(dict)
    try:
        for row in csv.DictReader(read_text(path).splitlines()):
            if row["cam_id"] in keys:
                times[int(row["sync_index"])][row["cam_id"]] = float(row["frame_time"])
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise InputError(path, "needs the columns sync_index, cam_id and frame_time, with numbers in them") from error
    instants = [times[index] for index in sorted(times)]
    if not instants or not np.isfinite([t for instant in instants for t in instant.values()]).all():
        raise InputError(path, "holds no usable time of any camera")
    taken = []
    for key, file, info in zip(keys, files, infos, strict=True):
        has = np.array([key in instant for instant in instants])
        if has.sum() != info.frame_count:
            raise InputError(path, f"has {has.sum()} times of {file.name}, which holds {info.frame_count} pictures")
        pictures = iter(info.times_ns)
        taken.append(tuple(next(pictures) if found else None for found in has))
    seconds = np.array([np.mean(list(instant.values())) for instant in instants])
    interval = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 1 / infos[0].fps
    if interval <= 0:
        raise InputError(path, "its times do not increase with sync_index")
    times_ns = tuple(round(s * 1e9) for s in seconds - seconds[0])
    return TimedVideos(tuple(files), times_ns, tuple(taken), 1 / interval)
