"""One video a camera, beside their calibration: the N3DV and Meet Room layouts.

    n3dv       camNN.mp4, two digits with gaps
    meetroom   cam_N.mp4, sorted as integers

    poses_bounds.npy   [N,17] (LLFF), or [N,14] with hwf_cxcy.npy [6]: height, width, fx, fy, cx, cy
    sparse/0           instead of poses_bounds.npy: a COLMAP model whose images are called like the videos
    distortion.json    optional: {"k1": .., "k2": .., "p1": .., "p2": .., "k3": ..} for all cameras, or an object of
                       these by camera name, in OpenCV's model and for the focal length in the calibration

Row i of poses_bounds.npy belongs to the i-th video in numeric order: 15 numbers are a 3x5 matrix, whose columns are the
camera's axes (down, right, backwards), its centre, and (height, width, focal length in pixels); two are depth bounds.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera
from streamlod.core.camera.camera import COEFFICIENTS
from streamlod.core.data.colmap.model import find_model, points_of, read_model
from streamlod.core.data.colmap.reader import fitted
from streamlod.core.data.dataset import RawRecording
from streamlod.core.data.files import blaming, number, read_array, read_json
from streamlod.core.data.names import files_in, listed, numeric_key
from streamlod.core.data.sources import videos
from streamlod.core.data.video import SUFFIXES
from streamlod.core.errors import InputError

PATTERNS = {"n3dv": re.compile(r"cam\d+", re.IGNORECASE), "meetroom": re.compile(r"cam_\d+", re.IGNORECASE)}
_MAX_NUMBER = 1e12


def video_files(path: Path, layout: str) -> list[Path]:
    """The cameras' videos in the order of their numbers, whatever the case of their names."""
    files = (file for file in files_in(path, SUFFIXES) if PATTERNS[layout].fullmatch(file.stem))
    return sorted(files, key=lambda file: numeric_key(file.stem.lower()))


def read_video_folder(path: Path, layout: str) -> RawRecording:
    """The recording in `path`; `layout` is ``n3dv`` or ``meetroom``.

    Raises:
        InputError: missing or damaged files, or files that do not belong together.
    """
    files = video_files(path, layout)
    if not files:
        example = "cam00.mp4" if layout == "n3dv" else "cam_0.mp4"
        raise InputError(path, f"holds no video called like {example}")
    names = [file.stem for file in files]
    poses, model = path / "poses_bounds.npy", find_model(path)
    depth_bounds = None
    if poses.is_file():
        with blaming(poses):
            cameras, depth_bounds = _llff_cameras(poses, names)
    elif model is not None:
        with blaming(model):
            cameras = _colmap_cameras(model, names)
    else:
        raise InputError(
            poses,
            "is missing, and so is a COLMAP model in sparse/0; one must give the cameras (or streamlod calibrate)",
        )
    cameras = _distorted(path / "distortion.json", cameras)
    source, infos = videos(files)
    sizes = [(info.width, info.height) for info in infos]
    cameras = [fitted(camera, size, file) for camera, size, file in zip(cameras, sizes, files, strict=True)]
    points = None if poses.is_file() or model is None else points_of(model)
    return RawRecording(path, layout, tuple(cameras), source, points, depth_bounds)


def llff_pose(columns: Float64) -> Float64:
    """[4,4] world_to_camera from LLFF's [3,4] matrix of axes (down, right, backwards) and centre."""
    down, right, back, centre = columns.T
    rotation = np.stack([right, down, -back])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ centre
    return pose


def _llff_cameras(path: Path, names: Sequence[str]) -> tuple[list[Camera], tuple[float, float]]:
    table = read_array(path)
    shared = path.with_name("hwf_cxcy.npy")
    columns = 14 if shared.is_file() else 17
    if table.ndim != 2 or table.shape[1] != columns:
        found = "x".join(map(str, table.shape)) or "a single number"
        raise InputError("its array", f"must have shape Nx{columns}, a row for each camera, not {found}")
    if len(table) != len(names):
        raise InputError(
            "its array",
            f"has {len(table)} rows, but there are {len(names)} videos ({listed(names)}); each row needs one video",
        )
    usable = (np.abs(table) < _MAX_NUMBER).all(axis=1)
    if not usable.all():
        row = int(np.flatnonzero(~usable)[0])
        raise InputError(
            f"camera {names[row]}", f"row {row} holds numbers that are not finite, or beyond {_MAX_NUMBER:g}"
        )
    near, far = float(table[:, -2].min()), float(table[:, -1].max())
    if not 0 < near < far:
        raise InputError("its depth bounds", f"run from {near:g} to {far:g}; near must be positive and below far")
    matrices = table[:, :-2].reshape(len(table), 3, -1)
    cameras = []
    for name, matrix in zip(names, matrices, strict=True):
        if matrix.shape[1] == 5:
            height, width, focal = matrix[:, 4]
            lens = np.array([height, width, focal, focal, width / 2, height / 2])
        else:
            lens = read_array(shared).reshape(-1)
        cameras.append(_camera(name, lens, llff_pose(matrix[:, :4]), shared))
    return cameras, (near, far)


def _camera(name: str, lens: Float64, pose: Float64, file: Path) -> Camera:
    if lens.shape != (6,):
        raise InputError(file, "must hold the six numbers height, width, fx, fy, cx, cy")
    height, width, fx, fy, cx, cy = lens
    if not np.isfinite(lens).all() or not (1 <= height < 1e6 and 1 <= width < 1e6):
        raise InputError(f"camera {name}", f"picture size {width:g}x{height:g} is not possible")
    intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
    return Camera(name, intrinsics, pose, round(width), round(height), np.zeros(5))


def _colmap_cameras(folder: Path, names: Sequence[str]) -> list[Camera]:
    model = read_model(folder)
    stems = [PurePosixPath(image.name.replace("\\", "/")).stem for image in model.images]
    double = [name for name in names if stems.count(name) > 1]
    if double:
        raise InputError("its images", f"hold several called {listed(double)}; which belongs to the video is not known")
    by_stem = dict(zip(stems, model.images, strict=True))
    missing = [name for name in names if name not in by_stem]
    if missing:
        raise InputError("its images", f"do not include {listed(missing)}, for which there are videos; remove these")
    return [model.camera_of(by_stem[name], name) for name in names]


def _distorted(path: Path, cameras: Sequence[Camera]) -> list[Camera]:
    """The cameras with the distortion of distortion.json, if there is such a file."""
    if not path.is_file():
        return list(cameras)
    value = read_json(path)
    given = value if any(isinstance(entry, dict) for entry in value.values()) else {c.name: value for c in cameras}
    result = []
    for camera in cameras:
        if not isinstance(given.get(camera.name), dict):
            raise InputError(path, f"has no coefficients of {camera.name}")
        with blaming(path):
            result.append(with_distortion(camera, given[camera.name], path))
    return result


def with_distortion(camera: Camera, coefficients: dict[str, object], path: Path) -> Camera:
    """`camera` with OpenCV coefficients by name, absent ones zero; InputError for other names or no numbers."""
    unknown = [key for key in coefficients if key not in COEFFICIENTS]
    if unknown:
        raise InputError(path, f"{listed(unknown)} is no coefficient; {', '.join(COEFFICIENTS)} are")
    values = [number(coefficients.get(key, 0), key, path) for key in COEFFICIENTS]
    return replace(camera, distortion=np.array(values, np.float64))
