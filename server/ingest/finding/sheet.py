"""A contact sheet: what all cameras see, side by side, each with its name."""

from __future__ import annotations

import math
from collections.abc import Mapping

import cv2
import numpy as np

from streamlod.core.arrays import UInt8

_TILE = (480, 360)  # width and height in pixels
_LINE = 28  # pixels of the line below a picture
_GREY, _INK, _QUIET = 40, (255, 255, 255), (170, 170, 170)
_QUALITY = 88


def contact_sheet(pictures: Mapping[str, UInt8 | None], notes: Mapping[str, str]) -> bytes:
    """A JPEG of all cameras.

    Args:
        pictures: by name, [H,W,3] RGB each, or None for a camera of which there is none.
        notes: what is written where a picture is missing.
    """
    columns = math.ceil(math.sqrt(len(pictures)))
    rows = math.ceil(len(pictures) / columns)
    width, height = _TILE[0], _TILE[1] + _LINE
    sheet = np.full((rows * height, columns * width, 3), _GREY, np.uint8)
    for number, (name, picture) in enumerate(pictures.items()):
        row, column = divmod(number, columns)
        tile = sheet[row * height : (row + 1) * height, column * width : (column + 1) * width]
        if picture is None:
            _write(tile, notes.get(name, "no picture"), _TILE[1] // 2, _QUIET)
        else:
            _place(tile[: _TILE[1]], picture)
        _write(tile, name, height - 9, _INK)
    ok, data = cv2.imencode(".jpg", sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    assert ok
    return data.tobytes()


def _place(tile: UInt8, picture: UInt8) -> None:
    """The whole picture in the middle of the tile."""
    scale = min(tile.shape[1] / picture.shape[1], tile.shape[0] / picture.shape[0])
    width, height = (max(1, round(side * scale)) for side in (picture.shape[1], picture.shape[0]))
    x, y = (tile.shape[1] - width) // 2, (tile.shape[0] - height) // 2
    tile[y : y + height, x : x + width] = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def _write(tile: UInt8, text: str, y: int, ink: tuple[int, int, int]) -> None:
    drawn = np.ascontiguousarray(tile)  # OpenCV draws into whole arrays only, and knows no letters beyond ASCII
    shown = text.encode("ascii", "replace").decode()
    cv2.putText(drawn, shown, (10, y), cv2.FONT_HERSHEY_SIMPLEX, 0.6, ink, 1, cv2.LINE_AA)
    tile[:] = drawn
