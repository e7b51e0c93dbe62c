"""Corners of the board in a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from streamlod.core.arrays import Bool, Float64, Int64, UInt8
from streamlod.core.calibration.board.description import Board

_MIN_CORNERS = 4
_SMALL_PICTURE = 1000  # pixels of the longer side below which markers are looked for at twice the size
_SMALL_SQUARES = (40.0, 15.0)  # pixels of a side below which a board is looked at two and three times larger
_FAINT = 3  # grey levels by which a marker's edge is darker than what surrounds it; OpenCV's 7 lose boards in haze


@dataclass(frozen=True, slots=True, eq=False)
class BoardSighting:
    """The corners and markers found in one picture.

    Attributes:
        corners: [J,2] pixels of the board's inner corners, NaN where not seen.
        markers: [M] ids of the markers found, in which one of another board may occur, or one twice.
    """

    corners: Float64
    markers: Int64

    @property
    def count(self) -> int:
        """Number of corners seen."""
        return int(np.isfinite(self.corners[:, 0]).sum())


class Detector:
    """Finds a board in pictures.

    Markers are looked for in the whole picture, then the board about them, larger where its squares are small: there
    corners are found twice as exactly, and so are markers that were missed, by where others say that they must lie
    (`python -m tests.bench.board_bench`).

    Args:
        board: the board as described.
    """

    def __init__(self, board: Board) -> None:
        self.board = board
        form, faint = board.opencv(), cv2.aruco.DetectorParameters()
        faint.adaptiveThreshConstant = _FAINT
        self._form = form
        self._markers = cv2.aruco.ArucoDetector(form.getDictionary())
        self._faint = cv2.aruco.ArucoDetector(form.getDictionary(), faint)
        self._corners = cv2.aruco.CharucoDetector(form)

    def __call__(self, picture: UInt8) -> BoardSighting:
        """The corners and markers in a picture [H,W,3] RGB or [H,W]."""
        grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) if picture.ndim == 3 else picture, np.uint8)
        if self.board.inverted:
            grey = 255 - grey
        found, markers, _ = _markers_in(self._markers, grey)
        own = self._on_board(found, markers)
        if not own.any() and max(grey.shape) < _SMALL_PICTURE:
            found, more, _ = _markers_in(self._markers, _enlarged(grey, 2))
            found, own = found / 2, self._on_board(found / 2, more)
        corners = np.full((self.board.corner_count, 2), np.nan)
        if own.any():
            points, ids = self._closer(grey, found[own])
            if len(ids) >= _MIN_CORNERS:
                corners[ids] = points
        return BoardSighting(corners, markers)

    def _on_board(self, quadrangles: Float64, markers: Int64) -> Bool:
        """[M] whether a marker is the board's, and lies where most others say that it must.

        Something in the room that is read as a marker of the board would make OpenCV doubt them all.

        Args:
            quadrangles: [M,4,2] pixels of the corners of markers.
            markers: [M] their ids.
        """
        own = markers < self.board.marker_count
        if own.sum() <= 2:
            return own
        shapes, found = np.asarray(self._form.getObjPoints())[markers[own], :, :2], quadrangles[own]
        _, agree = cv2.findHomography(shapes.reshape(-1, 2), found.reshape(-1, 2), cv2.RANSAC, _side(found))
        if agree is None or 2 * (agreeing := agree.reshape(-1, 4).all(axis=1)).sum() <= own.sum():
            return own
        lies = own.copy()
        lies[own] = agreeing
        return lies

    def _closer(self, grey: UInt8, quadrangles: Float64) -> tuple[Float64, Int64]:
        """The corners in the part of a picture where the board must lie: [N,2] pixels, [N] their numbers.

        Args:
            quadrangles: [M,4,2] pixels of the corners of markers, one or more.
        """
        square = _side(quadrangles) / self.board.marker_ratio
        reach = square * max(self.board.columns, self.board.rows)
        left, top = np.maximum(quadrangles.min(axis=(0, 1)) - reach, 0).astype(int)
        right, bottom = np.ceil(quadrangles.max(axis=(0, 1)) + reach).astype(int)
        factor = 1 + sum(square < limit for limit in _SMALL_SQUARES)
        part = _enlarged(grey[top:bottom, left:right], factor)
        found, markers, missed = _markers_in(self._faint, part)
        own = self._on_board(found, markers)
        if not own.any():
            return np.zeros((0, 2)), np.zeros(0, np.int64)
        refined = self._faint.refineDetectedMarkers(
            part, self._form, list(found[own].astype(np.float32)[:, None]), markers[own].astype(np.int32), missed
        )
        corners = self._corners.detectBoard(part, markerCorners=refined[0], markerIds=refined[1])
        points, ids = (np.zeros(0) if each is None else np.asarray(each) for each in corners[:2])
        return (points.reshape(-1, 2) + 0.5) / factor - 0.5 + [left, top], ids.ravel().astype(np.int64)


def _markers_in(detector: cv2.aruco.ArucoDetector, grey: UInt8) -> tuple[Float64, Int64, Sequence[cv2.typing.MatLike]]:
    """[M,4,2] pixels of the corners of markers of the board's dictionary, [M] their ids, and what may be others."""
    quadrangles, ids, missed = detector.detectMarkers(grey)
    found = np.zeros(0) if ids is None else np.asarray(ids)
    return np.reshape(np.asarray(quadrangles, np.float64), (-1, 4, 2)), found.ravel().astype(np.int64), missed


def _side(quadrangles: Float64) -> float:
    """Pixels of a usual side of quadrangles [M,4,2]."""
    return float(np.median(np.linalg.norm(quadrangles - np.roll(quadrangles, 1, axis=1), axis=2)))


def _enlarged(grey: UInt8, factor: int) -> UInt8:
    if factor == 1:
        return grey
    return np.asarray(cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC), np.uint8)


def variants(board: Board) -> list[Board]:
    """The board as described, and as it may look where the description leaves it open: inverted, or with the other
    corner's square white.
    """
    inverted = [board, replace(board, inverted=not board.inverted)]
    return [replace(each, legacy=legacy) for each in inverted for legacy in (board.legacy, not board.legacy)]
