"""Files of a calibrated rig: what `train` and `serve` read.

transforms.json      beside videos that are paired by their own times; `time_offset` is theirs
camera_array.toml    beside cam_N.mp4 with a timestamps.csv, which pairs them
rig.json             the same cameras for `serve --live`, whose sources are to be replaced by live ones
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.walk import WalkFootage
from streamlod.core.camera import Camera
from streamlod.core.camera.camera import COEFFICIENTS
from streamlod.core.data import caliscope, transforms
from streamlod.core.data.lens import opencv_matrix
from streamlod.core.errors import InputError
from streamlod.core.files import write_text

RIG = "rig.json"


class CalibratedRig(Protocol):
    """A rig as it is written, however it was calibrated; see `solve.Calibration`."""

    @property
    def cameras(self) -> tuple[Camera, ...]: ...
    @property
    def offsets(self) -> Float64: ...
    @property
    def periods(self) -> Float64: ...
    def rms(self, camera: int) -> float: ...


def check_folder(folder: Path, *, overwrite: bool) -> None:
    """Make `folder`; InputError if it cannot be written, or holds a calibration that is not to be replaced."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(folder, f"cannot be made ({error.strerror})") from error
    if not os.access(folder, os.W_OK):
        raise InputError(folder, "cannot be written (no permission); give another folder with --out")
    there = [name for name in (transforms.FILE, caliscope.FILE) if (folder / name).exists()]
    if there and not overwrite:
        raise InputError(folder / there[0], "is there already; remove it, or give another folder with --out")


def write_calibration(calibration: CalibratedRig, footage: Sequence[WalkFootage], folder: Path) -> list[Path]:
    """Write the rig's files into `folder`, with links to the videos if these are elsewhere; returns the files."""
    files = [each.file for each in footage if each.file is not None]
    for file in files:
        _linked(file, folder)
    table = files[0].with_name(caliscope.TIMES) if files else None
    written = []
    if table is not None and table.is_file() and all(_is_caliscope(file) for file in files):
        _linked(table, folder)
        written.append(_written(folder / caliscope.FILE, caliscope_text(calibration)))
    elif files:
        value = transforms_value(calibration, [file.name for file in files])
        written.append(_written(folder / transforms.FILE, json.dumps(value, indent=1) + "\n"))
    sources = [each.file.name if each.file is not None else "push:" for each in footage]
    rig = rig_value(calibration, sources)
    return [*written, _written(folder / RIG, json.dumps(rig, indent=1) + "\n")]


def transforms_value(calibration: CalibratedRig, names: Sequence[str]) -> dict[str, Any]:
    """The content of transforms.json for videos of these `names`."""
    frames = []
    for camera, name, offset in zip(calibration.cameras, names, calibration.offsets, strict=True):
        back = np.linalg.inv(camera.world_to_camera)
        back[:3, 1:3] *= -1  # OpenGL's axes
        matrix = camera.intrinsics
        frames.append(
            {
                "file_path": name,
                "w": camera.width, "h": camera.height,
                "fl_x": matrix[0, 0], "fl_y": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2],
                **dict(zip(COEFFICIENTS, camera.distortion.tolist(), strict=True)),
                "time_offset": float(offset),
                "transform_matrix": back.tolist(),
            }
        )  # fmt: skip
    return {"camera_model": "OPENCV", "frames": frames}


def caliscope_text(calibration: CalibratedRig) -> str:
    """The content of camera_array.toml; cameras are called cam_N."""
    parts = []
    for number, camera in enumerate(calibration.cameras):
        key, pose = camera.name.removeprefix("cam_"), camera.world_to_camera
        parts.append(
            f"[cameras.{key}]\ncam_id = {key}\nrotation_count = 0\nerror = {calibration.rms(number):.4f}\n"
            f"ignore = false\nsize = [{camera.width}, {camera.height}]\n"
            f"time_offset = {float(calibration.offsets[number])}\n"
            f"matrix = {opencv_matrix(camera).tolist()}\ndistortions = {camera.distortion.tolist()}\n"
            f"translation = {pose[:3, 3].tolist()}\nrotation = {pose[:3, :3].tolist()}\n"
        )
    return "\n".join(parts)


def rig_value(calibration: CalibratedRig, sources: Sequence[str]) -> dict[str, Any]:
    """The content of a rig.json."""
    return {
        "fps": round(1 / float(np.median(calibration.periods)), 3),
        "cameras": [_rig_camera(*each) for each in zip(calibration.cameras, sources, strict=True)],
    }


def _rig_camera(camera: Camera, source: str) -> dict[str, Any]:
    return {
        "name": "".join(c if c.isascii() and (c.isalnum() or c in "_.-") else "-" for c in camera.name)[-64:],
        "source": source,
        "width": camera.width,
        "height": camera.height,
        "intrinsics": camera.intrinsics.tolist(),
        "distortion": camera.distortion.tolist(),
        "world_to_camera": camera.world_to_camera.tolist(),
    }


def _is_caliscope(file: Path) -> bool:
    number = file.stem.removeprefix("cam_")
    return file.suffix == ".mp4" and number != file.stem and number.isascii() and number.isdecimal()


def _linked(file: Path, folder: Path) -> None:
    link = folder / file.name
    if file.parent.resolve() == folder.resolve() or link.exists():
        return
    try:
        link.symlink_to(file.resolve())
    except OSError as error:
        raise InputError(link, f"cannot be linked to {file} ({error.strerror})") from error


def _written(path: Path, text: str) -> Path:
    write_text(path, text)
    return path
