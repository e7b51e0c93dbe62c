"""Still pictures: PNG and JPEG, decoded only to the size that they announce."""

from __future__ import annotations

import logging
from collections import Counter, defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from streamlod.core.arrays import UInt8
from streamlod.core.data.announced import AnnouncedPicture, announced_picture
from streamlod.core.data.files import read_bytes
from streamlod.core.data.names import files_in, listed
from streamlod.core.errors import InputError

SUFFIXES = (".png", ".jpg", ".jpeg")
_NOT_READ = (".webp", ".heic", ".heif", ".avif", ".jxl", ".tif", ".tiff", ".bmp", ".gif", ".exr", ".dng", ".tga")
MAX_SIDE = 16384
_log = logging.getLogger(__name__)
_Key = TypeVar("_Key", bound=Hashable)
MAX_BYTES = 512 << 20


def picture_size(path: Path) -> tuple[int, int]:
    """(width, height) from the file's header, without decoding it; the log tells what Exif says in vain.

    Raises:
        InputError: missing, neither PNG nor JPEG, or of a size that is refused.
    """
    picture = _checked(path)
    if picture.turned:
        told = "%s: its Exif says that it is to be turned, which is not done: the calibration must be of it as stored"
        _log.warning(told, path)
    return picture.size


def read_picture(path: Path) -> UInt8:
    """[H,W,3] RGB.

    Raises:
        InputError: as in `picture_size`, or a file that cannot be decoded.
    """
    pixels = decode(_checked(path))
    if pixels is None:
        raise InputError(path, "cannot be decoded; the file is damaged, copy it again")
    return pixels


def decode(picture: AnnouncedPicture) -> UInt8 | None:
    """[H,W,3] RGB of the announced size, or None for a picture that is damaged.

    Transparency lies over black, the background of what is trained.
    """
    shape = picture.size[1], picture.size[0]
    if picture.transparent:
        found = _decoded(picture.data, cv2.IMREAD_UNCHANGED)
        if found is not None and found.shape == (*shape, 4):
            return _over_black(found)
    found = _decoded(picture.data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if found is None or found.shape != (*shape, 3):
        return None
    return np.asarray(cv2.cvtColor(found, cv2.COLOR_BGR2RGB), np.uint8)


def find_pictures(
    wanted: Mapping[_Key, Sequence[Path]], suffixes: tuple[str, ...] = SUFFIXES
) -> dict[_Key, Path | None]:
    """The file that each key stands for, of the first of its paths that leads to one; None where none does.

    Where a path leads to no file, a file beside it does whose name differs in its suffix or its case. A file
    that is not the first path stands for one key only: if it would for several, which of them it shows is not known.

    Args:
        suffixes: lower-case, of the files that count.
    """
    folders: dict[Path, dict[str, list[Path]]] = {}
    found = {
        key: next(filter(None, (_named(path, folders, suffixes) for path in paths)), None)
        for key, paths in wanted.items()
    }
    uses = Counter(found.values())
    return {key: file if uses[file] == 1 or file in wanted[key][:1] else None for key, file in found.items()}


def not_read(folders: Iterable[Path]) -> str:
    """A hint for messages about missing pictures: that the folders hold pictures of other kinds; else nothing."""
    others = [file.name for folder in sorted(set(folders)) if folder.is_dir() for file in files_in(folder, _NOT_READ)]
    return f" (only PNG and JPEG are read; convert {listed(others, 3)})" if others else ""


def _named(path: Path, folders: dict[Path, dict[str, list[Path]]], suffixes: tuple[str, ...]) -> Path | None:
    if path.is_file():
        return path
    folder = path.parent
    if folder not in folders:
        folders[folder] = defaultdict(list)
        for file in files_in(folder, suffixes) if folder.is_dir() else ():
            folders[folder][file.stem.casefold()].append(file)
    spellings = [(path.name, "")]
    if not path.suffix[1:].isdecimal():  # r.0001 has no suffix, but a number
        spellings.append((path.stem, path.suffix.lower()))
    for stem, suffix in spellings:
        files = folders[folder].get(stem.casefold())
        if files:
            return min(files, key=lambda file: (file.stem != stem, file.suffix.lower() != suffix))
    return None


def _decoded(data: bytes, flags: int) -> NDArray[Any] | None:
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:  # what OpenCV refuses by limits of its own
        return None


def _over_black(pixels: NDArray[Any]) -> UInt8:
    """[H,W,4] BGR and alpha, 8 or 16 bits each -> [H,W,3] RGB."""
    most = float(np.iinfo(pixels.dtype).max)
    seen = pixels[..., 2::-1] * (pixels[..., 3:] * np.float32(255 / most**2))
    return np.rint(seen).astype(np.uint8)


def _checked(path: Path) -> AnnouncedPicture:
    picture = announced_picture(read_bytes(path, MAX_BYTES))
    if picture is None:
        raise InputError(path, "is neither a PNG nor a JPEG picture, or not a whole one")
    if max(picture.size) > MAX_SIDE:
        width, height = picture.size
        raise InputError(path, f"a picture of {width}x{height} is refused; the limit is {MAX_SIDE} pixels a side")
    return picture
