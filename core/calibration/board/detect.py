"""Corners of the board in a picture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from streamlod.core.arrays import Float64, Int64, UInt8
from streamlod.core.calibration.board.description import Board

_MIN_CORNERS = 4


@dataclass(frozen=True, slots=True, eq=False)
class BoardSighting:
    """Finds in one picture.

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

    Args:
        board: the board as described.
    """

    def __init__(self, board: Board) -> None:
        self.board = board
        self._detector = cv2.aruco.CharucoDetector(board.opencv())

    def __call__(self, picture: UInt8) -> BoardSighting:
        """Finds in a picture [H,W,3] RGB or [H,W]."""
        grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) if picture.ndim == 3 else picture
        if self.board.inverted:
            grey = cv2.bitwise_not(grey)
        points, ids, _, markers = self._detector.detectBoard(grey)
        corners = np.full((self.board.corner_count, 2), np.nan)
        if ids is not None and len(ids) >= _MIN_CORNERS:
            corners[np.ravel(ids)] = np.reshape(points, (-1, 2))
        found = np.zeros(0, np.int64) if markers is None else np.ravel(markers).astype(np.int64)
        return BoardSighting(corners, found)


def variants(board: Board) -> list[Board]:
    """The board as described, and as it may look where the description leaves it open: inverted, or with the other
    corner's square white.
    """
    inverted = [board, replace(board, inverted=not board.inverted)]
    return [replace(each, legacy=legacy) for each in inverted for legacy in (board.legacy, not board.legacy)]
