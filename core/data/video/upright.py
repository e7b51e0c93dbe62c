"""Turns pictures as their display matrix says: a camera that hung upside down or stood on its side stores them so."""

from __future__ import annotations

import struct
from typing import Any

import av
import numpy as np
from av.sidedata.sidedata import SideDataContainer

from streamlod.core.arrays import UInt8
from streamlod.core.errors import InputError

_MATRIX = struct.Struct("=9i")  # the track matrix of ISO/IEC 14496-12: rows (a, b, u), (c, d, v), (x, y, w)
_SKEW = 0.02  # tangent of the angle by which a picture may miss a quarter turn


def upright(frame: av.VideoFrame, pixels: str = "rgb24") -> UInt8:
    """[H,W,3] as players show the picture: turned by quarters and mirrored where the file says so.

    Args:
        frame: a decoded picture.
        pixels: FFmpeg's name of the order of the colours.

    Raises:
        InputError: a picture that is turned by another angle.
    """
    stored = np.asarray(frame.to_ndarray(format=pixels), np.uint8)
    turn = _turn(frame)
    if turn is None:
        return stored
    sideways, rows, columns = turn
    return np.ascontiguousarray((stored.transpose(1, 0, 2) if sideways else stored)[::rows, ::columns])


def upright_size(frame: av.VideoFrame) -> tuple[int, int]:
    """(width, height) of what `upright` gives.

    Raises:
        InputError: as `upright`.
    """
    turn = _turn(frame)
    return (frame.height, frame.width) if turn is not None and turn[0] else (frame.width, frame.height)


def _turn(frame: av.VideoFrame) -> tuple[bool, int, int] | None:
    """Whether rows become columns, and the directions (1 or -1) in which rows and columns are then shown.

    A stored point (p right, q down) is shown at (a p + c q, b p + d q), up to a shift.
    """
    # Not `frame.side_data`, which a picture keeps and which keeps the picture: megabytes until cycles are collected.
    side = SideDataContainer(frame).get("DISPLAYMATRIX")  # type: ignore[call-arg]
    raw: Any = b"" if side is None else side  # PyAV's type stubs do not declare the buffer protocol
    data = bytes(raw)
    if len(data) < _MATRIX.size:
        return None
    a, b, _, c, d, *_ = _MATRIX.unpack_from(data)
    if (a, b, c, d) == (0, 0, 0, 0):  # says nothing
        return None
    sideways = abs(a) + abs(d) < abs(b) + abs(c)
    down, across = (b, c) if sideways else (d, a)  # where the first and the second axis of the array then lead
    others = (a, d) if sideways else (b, c)
    if max(map(abs, others)) > _SKEW * min(abs(down), abs(across)):
        raise InputError("picture", "is turned by no quarter of a circle; turn it upright with ffmpeg first")
    turn = sideways, (1 if down > 0 else -1), (1 if across > 0 else -1)
    return None if turn == (False, 1, 1) else turn
