"""Corners of the board in a picture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from streamlod.core.arrays import Float64, Int64, UInt8
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
        form, faint, missed = board.opencv(), cv2.aruco.DetectorParameters(), cv2.aruco.CharucoParameters()
        faint.adaptiveThreshConstant, missed.tryRefineMarkers = _FAINT, True
        self._markers = cv2.aruco.ArucoDetector(form.getDictionary())
        self._corners = cv2.aruco.CharucoDetector(form, missed, faint)

    def __call__(self, picture: UInt8) -> BoardSighting:
        """The corners and markers in a picture [H,W,3] RGB or [H,W]."""
        grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) if picture.ndim == 3 else picture, np.uint8)
        if self.board.inverted:
            grey = 255 - grey
        found, markers = self._markers_in(grey)
        own = markers < self.board.marker_count
        if not own.any() and max(grey.shape) < _SMALL_PICTURE:
            found, more = self._markers_in(_enlarged(grey, 2))
            found, own = found / 2, more < self.board.marker_count
        corners = np.full((self.board.corner_count, 2), np.nan)
        if own.any():
            points, ids = self._closer(grey, found[own])
            if len(ids) >= _MIN_CORNERS:
                corners[ids] = points
        return BoardSighting(corners, markers)

    def _markers_in(self, grey: UInt8) -> tuple[Float64, Int64]:
        """[M,4,2] pixels of the corners of markers of the board's dictionary, and [M] their ids."""
        quadrangles, ids, _ = self._markers.detectMarkers(grey)
        found = np.zeros(0) if ids is None else np.asarray(ids)
        return np.reshape(np.asarray(quadrangles, np.float64), (-1, 4, 2)), found.ravel().astype(np.int64)

    def _closer(self, grey: UInt8, quadrangles: Float64) -> tuple[Float64, Int64]:
        """The corners in the part of a picture where the board must lie: [N,2] pixels, [N] their numbers.

        Args:
            quadrangles: [M,4,2] pixels of the corners of markers, one or more.
        """
        side = float(np.median(np.linalg.norm(quadrangles - np.roll(quadrangles, 1, axis=1), axis=2)))
        square = side / self.board.marker_ratio
        reach = square * max(self.board.columns, self.board.rows)
        left, top = np.maximum(quadrangles.min(axis=(0, 1)) - reach, 0).astype(int)
        right, bottom = np.ceil(quadrangles.max(axis=(0, 1)) + reach).astype(int)
        factor = 1 + sum(square < limit for limit in _SMALL_SQUARES)
        found = self._corners.detectBoard(_enlarged(grey[top:bottom, left:right], factor))
        points, ids = (np.zeros(0) if each is None else np.asarray(each) for each in found[:2])
        return (points.reshape(-1, 2) + 0.5) / factor - 0.5 + [left, top], ids.ravel().astype(np.int64)


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
