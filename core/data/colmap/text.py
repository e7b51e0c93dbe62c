"""COLMAP's text files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from streamlod.core.data.colmap.types import ColmapCamera, ColmapImage, colmap_image, parameter_count
from streamlod.core.data.files import read_text
from streamlod.core.errors import InputError

_BEFORE_NAME = 9  # words of an image: number, quaternion, translation, camera


def read_cameras(path: Path) -> dict[int, ColmapCamera]:
    """Cameras by number; InputError for damage or models that are not supported."""
    cameras = {}
    for line, text in _lines(path):
        words = text.split()
        with _parsing(path, line):
            if not words:
                continue
            expected = parameter_count(path, words[1])
            parameters = tuple(float(word) for word in words[4:])
            if len(parameters) != expected:
                raise InputError(path, f"line {line}: {words[1]} has {expected} parameters, not {len(parameters)}")
            cameras[int(words[0])] = ColmapCamera(words[1], int(words[2]), int(words[3]), parameters)
    return cameras


def read_images(path: Path) -> Iterator[ColmapImage]:
    """Images in order; each has a second line, of observations, which may be empty or missing and is passed over."""
    expecting = True
    for line, text in _lines(path):
        words = text.split()
        if expecting and not words:
            continue
        if expecting or not _are_observations(words):
            with _parsing(path, line):
                values = [float(word) for word in words[1:8]]
                number = int(words[8])
                if len(words) == _BEFORE_NAME:
                    raise InputError(path, f"line {line}: the picture's name is missing")
            name = text.split(maxsplit=_BEFORE_NAME)[-1].rstrip()  # which may hold spaces
            yield colmap_image(path, name, number, tuple(values[:4]), tuple(values[4:]))
            expecting = False
        else:
            expecting = True


def read_points(path: Path) -> Iterator[tuple[float, ...]]:
    """x y z red green blue of each point; InputError for damage."""
    for line, text in _lines(path):
        words = text.split()
        if words:
            with _parsing(path, line):
                values = tuple(float(word) for word in words[1:7])
                if len(values) < 6:
                    raise InputError(path, f"line {line}: a point needs x y z and red green blue")
            yield values


def _are_observations(words: list[str]) -> bool:
    """Whether the line after an image's holds observations (x, y, number of a point) or nothing, and no other image.

    Programs that know no observations leave the line out.
    """
    if len(words) <= _BEFORE_NAME:
        return True
    try:
        float(words[_BEFORE_NAME])
    except ValueError:
        return False
    return len(words) % 3 == 0


@contextmanager
def _parsing(path: Path, line: int) -> Iterator[None]:
    """Turn numbers that are missing or cannot be read into an InputError with their line."""
    try:
        yield
    except (ValueError, IndexError, OverflowError) as error:
        raise InputError(path, f"line {line}: words or numbers are missing or cannot be read") from error


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    for number, text in enumerate(read_text(path, "surrogateescape").splitlines(), 1):
        if not text.startswith("#"):
            yield number, text
