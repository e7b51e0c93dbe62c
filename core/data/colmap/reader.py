"""COLMAP folders: a sparse model, and pictures of one instant or of many.

    sparse/0 + images*/                      one instant (of several models in sparse/, the largest)
    sparse/0 + frames/NNNN/                  many instants, one folder each
    NAME0/{sparse/0, images*/}, NAME1/...    many instants; the first model found gives the cameras

An instant's pictures lie in images/, else in images_2/, images_4/ ..., else in the instant's folder itself.
"""

from __future__ import annotations

import logging
from collections import Counter
from itertools import pairwise
from pathlib import Path, PurePosixPath

from streamlod.core.camera import Camera
from streamlod.core.data.colmap.model import ColmapModel, find_model, has_model, points_of, read_model
from streamlod.core.data.dataset import RawRecording
from streamlod.core.data.files import blaming
from streamlod.core.data.names import files_in, folders_in, inside, instant_numbers, like_most, listed, numeric_key
from streamlod.core.data.pictures import SUFFIXES, find_pictures, not_read, picture_size
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
    if twice := [name for name, count in Counter(image.name for image in model.images).items() if count > 1]:
        raise InputError(model_folder, f"places pictures twice: {listed(twice, 3)}")
    folders = _instants(path, home)
    instants = [_pictures_folder(folder) for folder in folders]
    found = _registered_files(model, instants[0])
    skipped = tuple(name for name, file in found.items() if file is None)
    if skipped:
        hint = not_read({instants[0], *((instants[0] / name).parent for name in skipped)})
        hint += "" if all(map(_is_utf8, skipped)) else " (names that are not UTF-8: export the model as UTF-8)"
        _log.warning("%s: %d pictures of the model are missing: %s%s", path, len(skipped), listed(skipped, 5), hint)
    files = {name: file for name, file in found.items() if file is not None}
    if not files:
        names = listed(skipped, 3)
        raise InputError(instants[0], f"holds none of the pictures that the COLMAP model names: {names}{hint}")
    _report_others(path, list(files.values()))
    cameras = []
    with blaming(model_folder):
        labels = _labels(list(files))
        by_name = {image.name: image for image in model.images}
        for name in sorted(files, key=lambda name: numeric_key(labels[name])):
            camera = model.camera_of(by_name[name], labels[name])
            cameras.append(
                (fitted(camera, picture_size(files[name]), files[name]), files[name].relative_to(instants[0]))
            )
    named = (
        (folder, tuple(pictures / name for _, name in cameras))
        for folder, pictures in zip(folders, instants, strict=True)
    )
    shown = [(folder, paths) for folder, paths in named if any(map(Path.is_file, paths))]
    source = Pictures(tuple(paths for _, paths in shown), _numbers([folder for folder, _ in shown]))
    return RawRecording(
        path,
        "colmap",
        tuple(camera for camera, _ in cameras),
        source,
        read_points=points_of(model_folder),
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
    return path if has_model(path) else next((folder for folder in folders_in(path) if has_model(folder)), None)


def _instants(path: Path, home: Path) -> list[Path]:
    """The folder of each instant, in order; folders that are called otherwise than most are none."""
    frames = path if home != path else path / "frames"
    folders = folders_in(frames) if frames.is_dir() else []
    instants = like_most(folders)
    if len(instants) < len(folders):
        others = listed((folder.name for folder in folders if folder not in instants), 5)
        _log.warning("%s: left out, as they are not called like an instant: %s", frames, others)
    if home != path:
        return [home, *(folder for folder in instants if numeric_key(folder.name) > numeric_key(home.name))]
    return instants or [path]


def _numbers(instants: list[Path]) -> tuple[int, ...]:
    """How many periods after the first each instant lies by its folder's number; those left out are logged."""
    numbers = instant_numbers([folder.name for folder in instants])
    if missing := numbers[-1] + 1 - len(numbers):
        gaps = (folder for folder, (a, b) in zip(instants, pairwise(numbers), strict=False) if b > a + 1)
        after = listed((folder.name for folder in gaps), 5)
        fault = "%s: %d instants have no pictures, after %s; the one before is shown until the next"
        _log.warning(fault, instants[0].parent, missing, after)
    return numbers


def _pictures_folder(instant: Path) -> Path:
    candidates = [folder for folder in folders_in(instant) if folder.name.split("_")[0] == "images"]
    return candidates[0] if candidates else instant


def _registered_files(model: ColmapModel, folder: Path) -> dict[str, Path | None]:
    """The file of each image of the model, in the folder that it names or, where these were put together, in none."""
    wanted = {}
    for image in model.images:
        posix = image.name.replace("\\", "/")  # Windows writes it otherwise
        spellings = (image.name, posix, PurePosixPath(posix).name)
        wanted[image.name] = [path for name in spellings if (path := inside(folder, name)) is not None]
    return find_pictures(wanted)


def _report_others(path: Path, used: list[Path]) -> None:
    """Log pictures beside those used: COLMAP could not place them, or placed them in another model."""
    beside = {file for folder in {file.parent for file in used} for file in files_in(folder, SUFFIXES)}
    others = sorted((file.name for file in beside - set(used)), key=numeric_key)
    if not others:
        return
    names = listed(others, 5)
    _log.warning("%s: %d pictures are left out, as the model does not place them: %s", path, len(others), names)
    if len({file.parent for file in used}) == len(used) > 1:
        _log.warning("%s: each camera has a folder here; if its other pictures are later instants, put those of each "
                     "instant into a folder frames/0000, frames/0001, ..., called as in the model", path)  # fmt: skip


def _labels(names: list[str]) -> dict[str, str]:
    """Camera names: the pictures' stems where these differ, otherwise their paths without suffix."""
    paths = {name: PurePosixPath(name.replace("\\", "/")) for name in names}
    stems = {name: path.stem for name, path in paths.items()}
    if len(set(stems.values())) == len(names):
        return stems
    return {name: path.with_suffix("").as_posix() for name, path in paths.items()}


def _is_utf8(name: str) -> bool:
    return not any("\udc80" <= letter <= "\udcff" for letter in name)
