"""Still pictures: PNG and JPEG, decoded only to the size that they announce."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from streamlod.core.arrays import UInt8
from streamlod.core.data.announced import AnnouncedPicture, announced_picture
from streamlod.core.data.files import read_bytes
from streamlod.core.errors import InputError

SUFFIXES = (".png", ".jpg", ".jpeg")
MAX_SIDE = 16384
MAX_BYTES = 512 << 20


def picture_size(path: Path) -> tuple[int, int]:
    """(width, height) from the file's header, without decoding it.

    Raises:
        InputError: missing, neither PNG nor JPEG, or of a size that is refused.
    """
    return _checked(path).size


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
    """[H,W,3] RGB of the announced size, or None for a picture that is damaged."""
    try:
        found = cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:  # what OpenCV refuses by limits of its own
        return None
    if found is None or found.shape != (picture.size[1], picture.size[0], 3):
        return None
    return np.asarray(cv2.cvtColor(found, cv2.COLOR_BGR2RGB), np.uint8)


def _checked(path: Path) -> AnnouncedPicture:
    picture = announced_picture(read_bytes(path, MAX_BYTES))
    if picture is None:
        raise InputError(path, "is neither a PNG nor a JPEG picture, or not a whole one")
    if max(picture.size) > MAX_SIDE:
        width, height = picture.size
        raise InputError(path, f"a picture of {width}x{height} is refused; the limit is {MAX_SIDE} pixels a side")
    return picture
