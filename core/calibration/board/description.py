"""A ChArUco board: a chessboard whose white squares hold ArUco markers."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.track import MIN_CORNERS
from streamlod.core.data.files import number, read_text
from streamlod.core.errors import InputError

FILE = "charuco.toml"
MAX_SQUARES = 40  # along a side
_METRES = {"inch": 0.0254, "cm": 0.01, "mm": 0.001, "m": 1.0}
_MAX_SQUARE_M = 5.0


@dataclass(frozen=True, slots=True)
class Board:
    """A board as it was printed.

    Attributes:
        columns, rows: number of squares across and down.
        square_m: side of a square in metres.
        marker_ratio: side of a marker, as a part of a square's.
        dictionary: OpenCV's name of the markers' dictionary.
        inverted: whether black and white are exchanged.
        legacy: whether the top left square is white although the number of rows is even, as OpenCV had it before 4.6.

    Raises:
        InputError: numbers that no board has, or a dictionary that does not exist or has too few markers.
    """

    columns: int = 7
    rows: int = 5
    square_m: float = 0.055
    marker_ratio: float = 0.75
    dictionary: str = "DICT_4X4_50"
    inverted: bool = False
    legacy: bool = False

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= MAX_SQUARES and 3 <= self.rows <= MAX_SQUARES):
            raise InputError("board", f"needs 3 to {MAX_SQUARES} squares a side, not {self.columns}x{self.rows}")
        if self.corner_count < MIN_CORNERS:
            fault = f"{self.columns}x{self.rows} squares have {self.corner_count} inner corners, but {MIN_CORNERS} are"
            raise InputError("board", f"{fault} needed; take 4x3 or more")
        if not 0.001 <= self.square_m <= _MAX_SQUARE_M:
            raise InputError("board", f"has squares of {self.square_m * 1000:g} mm; 1 to 5000 mm are possible")
        if not 0.3 <= self.marker_ratio <= 0.95:
            raise InputError("board", f"has markers of {self.marker_ratio:g} of a square; 0.3 to 0.95 are possible")
        known = getattr(cv2.aruco, self.dictionary, None) if self.dictionary.startswith("DICT_") else None
        if not isinstance(known, int):
            raise InputError("board", f"the dictionary {self.dictionary!r:.40} is unknown to OpenCV; try DICT_4X4_50")
        size = len(cv2.aruco.getPredefinedDictionary(known).bytesList)
        if size < self.marker_count:
            raise InputError("board", f"needs {self.marker_count} markers, but {self.dictionary} has {size}")

    @property
    def marker_count(self) -> int:
        """Number of markers, whose ids run from 0."""
        return self.columns * self.rows // 2

    @property
    def corner_count(self) -> int:
        """Number of inner chessboard corners, J."""
        return (self.columns - 1) * (self.rows - 1)

    @property
    def corners(self) -> Float64:
        """[J,3] inner corners in metres: x right, y down, z into the board, from its top left corner."""
        down, across = np.divmod(np.arange(self.corner_count), self.columns - 1)
        plane = np.stack([across + 1, down + 1, np.zeros_like(down)], axis=1)
        return np.asarray(plane * self.square_m, np.float64)

    @property
    def centre(self) -> Float64:
        """[3] middle of the board in metres, in the axes of `corners`."""
        return np.array([self.columns * self.square_m / 2, self.rows * self.square_m / 2, 0.0])

    def opencv(self) -> Any:
        """OpenCV's form of the board."""
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        size = self.columns, self.rows
        board = cv2.aruco.CharucoBoard(size, self.square_m, self.square_m * self.marker_ratio, dictionary)
        board.setLegacyPattern(self.legacy)
        return board

    def described(self) -> str:
        """Size in words, such as ``7x5 squares of 55 mm``."""
        return f"{self.columns}x{self.rows} squares of {self.square_m * 1000:g} mm"


DEFAULT = Board()


def read_board(path: Path) -> Board:
    """The board that a charuco.toml of caliscope describes, or one that `board_text` wrote.

    Raises:
        InputError: the file cannot be read, or describes no board that can be used.
    """
    try:
        table = tomllib.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"is not valid TOML: {error}") from error
    counts = [number(table.get(key), key, path) for key in ("columns", "rows")]
    if any(count != int(count) or not 0 < count < 1000 for count in counts):
        raise InputError(path, "columns and rows must be whole numbers of squares")
    columns, rows = (int(count) for count in counts)
    dictionary, inverted = table.get("dictionary", DEFAULT.dictionary), table.get("inverted", False)
    legacy = table.get("legacy_pattern", False)
    if not isinstance(dictionary, str) or not isinstance(inverted, bool) or not isinstance(legacy, bool):
        raise InputError(path, "dictionary must be a name; inverted and legacy_pattern must be true or false")
    ratio = number(table.get("aruco_scale", DEFAULT.marker_ratio), "aruco_scale", path)
    board = Board(columns, rows, DEFAULT.square_m, ratio, dictionary, inverted, legacy)
    return replace(board, square_m=_square_m(table, board, path))


def board_text(board: Board) -> str:
    """The content of a charuco.toml that describes `board`."""
    return (
        f"columns = {board.columns}\nrows = {board.rows}\nsquare_size_override_cm = {board.square_m * 100:.6g}\n"
        f'aruco_scale = {board.marker_ratio:g}\ndictionary = "{board.dictionary}"\n'
        f"inverted = {str(board.inverted).lower()}\nlegacy_pattern = {str(board.legacy).lower()}\n"
    )


def _square_m(table: dict[str, Any], board: Board, path: Path) -> float:
    if table.get("square_size_override_cm") is not None:
        return number(table["square_size_override_cm"], "square_size_override_cm", path) / 100
    unit = _METRES.get(str(table.get("units", "inch")))
    if unit is None:
        raise InputError(path, f"units must be one of {', '.join(_METRES)}")
    width, height = (number(table.get(key), key, path) for key in ("board_width", "board_height"))
    return unit * min(width / board.columns, height / board.rows)
