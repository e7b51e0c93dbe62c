"""transforms.json, as nerfstudio and instant-ngp write it: one instant of pictures, or a video for each camera.

Data of NeRF's kind have transforms_train.json instead; what is held out beside it (transforms_test.json) is not used.

A frame's ``transform_matrix`` is camera_to_world with OpenGL's axes (x right, y up, z backwards). Intrinsics and
distortion stand at the top or in the frame: ``fl_x fl_y cx cy w h``, or ``camera_angle_x``; ``k1 k2 p1 p2 k3``.
A video's ``time_offset`` in seconds, which `streamlod calibrate` writes, is added to the times of its pictures.
Files that are listed but missing are left out and counted.
"""

from __future__ import annotations

import logging
import math
from pathlib import Path
from typing import Any

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera
from streamlod.core.camera.camera import COEFFICIENTS
from streamlod.core.data.colmap.reader import fitted
from streamlod.core.data.dataset import RawRecording, Source
from streamlod.core.data.files import blaming, number, numbers, read_json
from streamlod.core.data.names import inside, listed, numeric_key
from streamlod.core.data.pictures import SUFFIXES as PICTURE_SUFFIXES
from streamlod.core.data.pictures import find_pictures, not_read, picture_size
from streamlod.core.data.sources import Pictures, videos
from streamlod.core.data.video import SUFFIXES as VIDEO_SUFFIXES
from streamlod.core.errors import InputError

FILE = "transforms.json"
_OF_NERF = "transforms_train.json"
MAX_FRAMES = 4096
_MAX_OFFSET_S = 86_400
_log = logging.getLogger(__name__)
_MODELS = ("OPENCV", "FULL_OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_LENSES = ("is_fisheye", "latlong", "equirectangular", "ftheta_p0")  # of instant-ngp, where they are true or given
# of fisheye, rational, thin prism and tilted models
_UNSUPPORTED = ("k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")


def file_in(folder: Path) -> Path | None:
    """The file of this layout in `folder`; None without."""
    return next((folder / name for name in (FILE, _OF_NERF) if (folder / name).is_file()), None)


def read_transforms(path: Path) -> RawRecording:
    """The recording in the folder `path`.

    Raises:
        InputError: missing or damaged files, several instants in one file, or a lens that is not supported.
    """
    file = file_in(path) or path / FILE
    value = read_json(file)
    if file.name == _OF_NERF:
        left_out = [other for split in ("test", "val") if (other := path / f"transforms_{split}.json").is_file()]
        if left_out:
            _log.info("%s: its cameras are used, not those of %s", file, listed(other.name for other in left_out))
    frames = value.get("frames")
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise InputError(file, "'frames' must be a list of objects")
    if len(frames) > MAX_FRAMES:
        raise InputError(file, f"lists {len(frames)} frames; the limit is {MAX_FRAMES}")
    if len({frame.get("time") for frame in frames if not isinstance(frame.get("time"), dict | list)}) > 1:
        raise InputError(file, "lists several instants ('time'); list each camera once, with a video")
    if not frames:
        raise InputError(file, "'frames' lists no pictures")
    wanted = {number: _spellings(path, frame.get("file_path"), file) for number, frame in enumerate(frames)}
    found = find_pictures(wanted, PICTURE_SUFFIXES + VIDEO_SUFFIXES)
    entries = [(known, {**value, **frames[number]}) for number, known in found.items() if known is not None]
    skipped = [str(frames[number]["file_path"]) for number, known in found.items() if known is None]
    hint = not_read(wanted[number][0].parent for number, known in found.items() if known is None)
    if any("mask_path" in frame for frame in frames):
        _log.warning("%s: masks (mask_path) are not used; what they hide is trained, too", file)
    if skipped:
        missing = listed(skipped, 5) + hint
        _log.warning("%s: %d of %d listed files are missing: %s", file, len(skipped), len(frames), missing)
    if not entries:
        raise InputError(file, f"lists {len(frames)} files, none of which is there: {listed(skipped, 3)}{hint}")
    entries.sort(key=lambda entry: numeric_key(entry[0].as_posix()))
    files = [entry[0] for entry in entries]
    offsets = [number(settings.get("time_offset", 0), "time_offset", file) for _, settings in entries]
    source, sizes = _source(files, offsets, file)
    names = [f.stem for f in files]
    if len(set(names)) < len(names):
        names = [f.relative_to(path).with_suffix("").as_posix() for f in files]
    with blaming(file):
        cameras = [
            _camera(name, settings, size, picture, file)
            for name, (picture, settings), size in zip(names, entries, sizes, strict=True)
        ]
    return RawRecording(path, "transforms", tuple(cameras), source, skipped=tuple(skipped))


def opengl_pose(matrix: Float64) -> Float64:
    """[4,4] world_to_camera with OpenCV's axes from camera_to_world with OpenGL's."""
    rotation = (matrix[:3, :3] * [1, -1, -1]).T
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ matrix[:3, 3]
    return pose


def _spellings(folder: Path, name: object, file: Path) -> list[Path]:
    if not isinstance(name, str) or not name or "\0" in name:
        raise InputError(file, "each frame needs a 'file_path'")
    paths = [inside(folder, spelling) for spelling in (name, name.replace("\\", "/"))]  # Windows writes it otherwise
    if None in paths:
        raise InputError(file, f"file_path {name!r} leads out of the folder")
    return [path for path in paths if path is not None]


def _source(files: list[Path], offsets: list[float], file: Path) -> tuple[Source, list[tuple[int, int]]]:
    kinds = {f.suffix.lower() in VIDEO_SUFFIXES for f in files}
    if len(kinds) > 1:
        raise InputError(file, "lists both pictures and videos; use one kind")
    if kinds == {True}:
        if not all(abs(offset) <= _MAX_OFFSET_S for offset in offsets):
            raise InputError(file, f"a time_offset is beyond {_MAX_OFFSET_S} seconds")
        source, infos = videos(files, [round(offset * 1e9) for offset in offsets])
        return source, [(info.width, info.height) for info in infos]
    return Pictures((tuple(files),)), [picture_size(f) for f in files]


def _camera(name: str, settings: dict[str, Any], size: tuple[int, int], picture: Path, file: Path) -> Camera:
    for key in _LENSES:
        if settings.get(key):
            raise InputError(
                f"camera {name}", f"a lens of another kind ({key}) is not supported; undistort the pictures first"
            )
    if settings.get("camera_model", "OPENCV") not in _MODELS:
        model = settings["camera_model"]
        raise InputError(f"camera {name}", f"lens model {model!s:.40} is not supported ({', '.join(_MODELS)} are)")
    for key in _UNSUPPORTED:
        if number(settings.get(key, 0), key, file) != 0:
            raise InputError(f"camera {name}", f"the coefficient {key} is not supported; undistort the pictures first")
    width = number(settings.get("w", size[0]), "w", file)
    height = number(settings.get("h", size[1]), "h", file)
    if not (1 <= width < 1e6 and 1 <= height < 1e6):
        raise InputError(f"camera {name}", f"picture size {width:g}x{height:g} is not possible")
    fx, fy = _focal_lengths(name, settings, width, height, file)
    cx, cy = number(settings.get("cx", width / 2), "cx", file), number(settings.get("cy", height / 2), "cy", file)
    matrix = settings.get("transform_matrix")
    rows = 3 if isinstance(matrix, list) and len(matrix) == 3 else 4  # some leave out the last, which is always 0 0 0 1
    matrix = numbers(matrix, (rows, 4), f"transform_matrix of {name}", file)
    if rows == 4 and np.abs(matrix[3, :3]).max() > 1e-6:
        raise InputError(f"camera {name}", "the last row of its transform_matrix is not 0 0 0 1; is it transposed?")
    with np.errstate(all="ignore"):  # whatever comes of absurd numbers, Camera refuses it
        pose = opengl_pose(matrix)
    camera = Camera(
        name,
        np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64),
        pose,
        round(width),
        round(height),
        np.array([number(settings.get(key, 0), key, file) for key in COEFFICIENTS], np.float64),
    )
    return fitted(camera, size, picture)


def _focal_lengths(name: str, settings: dict[str, Any], width: float, height: float, file: Path) -> tuple[float, float]:
    """fl_x and fl_y, from each other or from the angle of view where one is missing."""
    given: list[float | None] = []
    for key, angle_key, side in (("fl_x", "camera_angle_x", width), ("fl_y", "camera_angle_y", height)):
        if key in settings:
            given.append(number(settings[key], key, file))
        elif angle_key in settings:
            angle = number(settings[angle_key], angle_key, file)
            if not 0 < angle < math.pi:
                raise InputError(f"camera {name}", f"{angle_key} must lie between 0 and pi, not {angle:g}")
            given.append(side / 2 / math.tan(angle / 2))
        else:
            given.append(None)
    fx, fy = given
    fx, fy = (fy if fx is None else fx), (fx if fy is None else fy)
    if fx is None or fy is None:
        raise InputError(f"camera {name}", "its focal length is missing: give fl_x or camera_angle_x")
    return fx, fy
