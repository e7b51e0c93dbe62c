"""COLMAP folders: a sparse model, and pictures of one instant or of many.

    sparse/0 + images*/                      one instant
    sparse/0 + frames/NNNN/                  many instants, one folder each
    NAME0/{sparse/0, images*/}, NAME1/...    many instants; the first model found gives the cameras

An instant's pictures lie in images/, else in images_2/, images_4/ ..., else in the instant's folder itself.
"""

from __future__ import annotations

import logging
from pathlib import Path

from streamlod.core.camera import Camera
from streamlod.core.data.colmap.model import ColmapModel, find_model, read_model, read_points
from streamlod.core.data.dataset import RawRecording
from streamlod.core.data.files import blaming
from streamlod.core.data.names import listed, numeric_key
from streamlod.core.data.pictures import SUFFIXES, picture_size
from streamlod.core.data.sources import Pictures
from streamlod.core.errors import InputError

_log = logging.getLogger(__name__)
_ASPECT_TOLERANCE = 0.01


def is_colmap(path: Path) -> bool:
    """Whether `path` or one of its folders holds a sparse model."""
    return _model_home(path) is not None


def read_colmap(path: Path) -> RawRecording:
    """The recording in `path`.

    Raises:
        InputError: no model, no pictures, or a model that is damaged or does not fit the pictures.
    """
    home = _model_home(path)
    model_folder = None if home is None else find_model(home)
    if home is None or model_folder is None:
        raise InputError(path, "holds no COLMAP model: sparse/0/cameras.bin (or .txt) is missing")
    model = read_model(model_folder)
    instants = [_pictures_folder(folder) for folder in _instants(path, home)]
    found = _registered_files(model, instants[0])
    skipped = tuple(name for name, file in found.items() if file is None)
    if skipped:
        _log.warning("%s: %d pictures of the model are missing: %s", path, len(skipped), listed(skipped, 5))
    files = {name: file for name, file in found.items() if file is not None}
    if not files:
        raise InputError(instants[0], "holds none of the pictures that the COLMAP model names")
    cameras = []
    with blaming(model_folder):
        labels = _labels(list(files))
        by_name = {image.name: image for image in model.images}
        for name in sorted(files, key=lambda name: numeric_key(labels[name])):
            camera = model.camera_of(by_name[name], labels[name])
            cameras.append(
                (fitted(camera, picture_size(files[name]), files[name]), files[name].relative_to(instants[0]))
            )
    source = Pictures(tuple(tuple(folder / relative for _, relative in cameras) for folder in instants))
    return RawRecording(
        path,
        "colmap",
        tuple(camera for camera, _ in cameras),
        source,
        read_points=lambda: read_points(model_folder),
        skipped=skipped,
    )


def fitted(camera: Camera, size: tuple[int, int], file: Path) -> Camera:
    """`camera`, scaled to pictures of `size`, which may be reduced; InputError if their shape differs."""
    across, down = size[0] / camera.width, size[1] / camera.height
    if abs(across / down - 1) > _ASPECT_TOLERANCE:
        raise InputError(
            file, f"has {size[0]}x{size[1]} pixels, which does not fit the calibration's {camera.width}x{camera.height}"
        )
    return camera.scaled(*size)


def _model_home(path: Path) -> Path | None:
    if find_model(path) is not None:
        return path
    return next((folder for folder in _folders(path) if find_model(folder) is not None), None)


def _folders(path: Path) -> list[Path]:
    found = (entry for entry in path.iterdir() if entry.is_dir() and not entry.name.startswith("."))
    return sorted(found, key=lambda folder: numeric_key(folder.name))


def _instants(path: Path, home: Path) -> list[Path]:
    """The folder of each instant, in order."""
    if home != path:
        return [folder for folder in _folders(path) if numeric_key(folder.name) >= numeric_key(home.name)]
    frames = path / "frames"
    return (_folders(frames) if frames.is_dir() else []) or [path]


def _pictures_folder(instant: Path) -> Path:
    candidates = [folder for folder in _folders(instant) if folder.name.split("_")[0] == "images"]
    return candidates[0] if candidates else instant


def _registered_files(model: ColmapModel, folder: Path) -> dict[str, Path | None]:
    """The file of each image of the model: of that name, else of that stem."""
    by_stem = {file.stem: file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES}
    files: dict[str, Path | None] = {}
    for image in model.images:
        exact = folder / image.name
        inside = folder.resolve() in exact.resolve().parents
        files[image.name] = exact if inside and exact.is_file() else by_stem.get(Path(image.name).stem)
    return files


def _labels(names: list[str]) -> dict[str, str]:
    """Camera names: the pictures' stems where these differ, otherwise their paths without suffix."""
    stems = {name: Path(name).stem for name in names}
    if len(set(stems.values())) == len(names):
        return stems
    return {name: Path(name).with_suffix("").as_posix() for name in names}
