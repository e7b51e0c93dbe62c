"""Still pictures from files: PNG and JPEG."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np

from core.arrays import UInt8
from core.data.files import read_bytes
from core.errors import InputError

SUFFIXES = (".png", ".jpg", ".jpeg")
MAX_SIDE = 16384
MAX_BYTES = 512 << 20

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8"
_JPEG_FRAME_HEADERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


def picture_size(path: Path) -> tuple[int, int]:
    """(width, height) from the file's header, without decoding it.

    Raises:
        InputError: missing, neither PNG nor JPEG, or of a size that is refused.
    """
    return _checked(path)[0]


def read_picture(path: Path) -> UInt8:
    """[H,W,3] RGB.

    Raises:
        InputError: as in `picture_size`, or a file that cannot be decoded.
    """
    _, data = _checked(path)
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if picture is None:
        raise InputError(path, "cannot be decoded; the file is damaged, copy it again")
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)


def _checked(path: Path) -> tuple[tuple[int, int], bytes]:
    data = read_bytes(path, MAX_BYTES)
    size = encoded_size(data)
    if size is None:
        raise InputError(path, "is neither a PNG nor a JPEG picture")
    if not (1 <= size[0] <= MAX_SIDE and 1 <= size[1] <= MAX_SIDE):
        raise InputError(path, f"a picture of {size[0]}x{size[1]} is refused; the limit is {MAX_SIDE} pixels a side")
    return size, data


def encoded_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) from the header of PNG or JPEG bytes, or None for anything else; nothing is decoded."""
    if data.startswith(_PNG) and len(data) >= 24:
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    if data.startswith(_JPEG):
        return _jpeg_size(data)
    return None


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Walk the marker segments to the frame header (ITU-T T.81, section B.1.1)."""
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], struct.unpack_from(">H", data, at + 2)[0]
        if marker == 0xFF:  # fill byte
            at += 1
        elif marker in _JPEG_FRAME_HEADERS:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        else:
            at += 2 + length
    return None
