"""The board on paper, at its true size: PDF, or PNG at 300 dots an inch."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np

from streamlod.core.arrays import UInt8
from streamlod.core.calibration.board.description import Board
from streamlod.core.errors import InputError
from streamlod.core.files import write_bytes

PAPERS = {"A4": (297.0, 210.0), "A3": (420.0, 297.0), "A2": (594.0, 420.0), "A1": (841.0, 594.0), "A0": (1189.0, 841.0)}
_MARGIN_MM = 8.0  # that printers leave white
_DPI = 300
_MM = 25.4  # an inch


def fitted_to(board: Board, paper: str) -> Board:
    """The board with the largest squares, in whole millimetres, that fit `paper`.

    Raises:
        InputError: squares of less than 10 mm.
    """
    width, height = PAPERS[paper]
    side = int(min((width - 2 * _MARGIN_MM) / board.columns, (height - 2 * _MARGIN_MM) / board.rows))
    if side < 10:
        raise InputError(paper, f"is too small for a board of {board.columns}x{board.rows} squares; take fewer squares")
    return replace(board, square_m=side / 1000)


def print_board(board: Board, path: Path) -> str:
    """Write the board for printing, and return the name of the paper that it needs.

    Raises:
        InputError: neither .pdf nor .png, a board larger than A0, or a file that cannot be written.
    """
    size = board.columns * board.square_m * 1000, board.rows * board.square_m * 1000
    paper = next(
        (name for name, (w, h) in PAPERS.items() if w - 2 * _MARGIN_MM >= size[0] and h - 2 * _MARGIN_MM >= size[1]),
        None,
    )
    if paper is None:
        raise InputError("board", f"of {size[0]:.0f}x{size[1]:.0f} mm does not fit on A0 across; take smaller squares")
    if path.suffix.lower() == ".png":
        write_bytes(path, _png(board, PAPERS[paper]))
    elif path.suffix.lower() == ".pdf":
        write_bytes(path, _pdf(board, PAPERS[paper]))
    else:
        raise InputError(path, "must end in .pdf or .png")
    return paper


def squares(board: Board, pixels: int) -> UInt8:
    """[rows * pixels, columns * pixels] the board without a margin, a square `pixels` wide."""
    picture = board.opencv().generateImage((board.columns * pixels, board.rows * pixels), marginSize=0, borderBits=1)
    return np.asarray(255 - picture if board.inverted else picture, np.uint8)


def _words(board: Board) -> str:
    return f"streamlod: {board.described()}, {board.dictionary}. Print at 100 %, glue it on something flat, measure."


def _png(board: Board, paper: tuple[float, float]) -> bytes:
    width, height = (round(side / _MM * _DPI) for side in paper)
    side = round(board.square_m * 1000 / _MM * _DPI)
    page = np.full((height, width), 255, np.uint8)
    picture = squares(board, side)
    top, left = (height - picture.shape[0]) // 2, (width - picture.shape[1]) // 2
    page[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    cv2.putText(page, _words(board), (left, height - 30), cv2.FONT_HERSHEY_SIMPLEX, 1.2, 100, 2, cv2.LINE_AA)
    done, data = cv2.imencode(".png", page)
    if not done:
        raise InputError("board", "cannot be encoded as PNG")
    return _with_density(data.tobytes())


def _with_density(png: bytes) -> bytes:
    """The file with its resolution stated (chunk pHYs), by which printers take its true size."""
    dots = round(_DPI / 0.0254)
    body = b"pHYs" + struct.pack(">IIB", dots, dots, 1)
    after_header = 8 + 25  # signature and IHDR
    chunk = struct.pack(">I", 9) + body + struct.pack(">I", zlib.crc32(body))
    return png[:after_header] + chunk + png[after_header:]


def _pdf(board: Board, paper: tuple[float, float]) -> bytes:
    """One page with a rectangle for each run of black cells: sharp at any size."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    cells = 24  # a square's: markers of 4x4 to 7x7 cells with borders, in 3/4 of it, end on these or within 1 %
    picture = squares(board, cells * 8) < 128
    side = board.square_m * 1000 / (cells * 8)
    figure = Figure(figsize=(paper[0] / _MM, paper[1] / _MM))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set_xlim(0, paper[0])
    axes.set_ylim(paper[1], 0)
    left, top = (paper[0] - picture.shape[1] * side) / 2, (paper[1] - picture.shape[0] * side) / 2
    boxes = [
        [(left + x0 * side, top + y0 * side), (left + x1 * side, top + y0 * side),
         (left + x1 * side, top + y1 * side), (left + x0 * side, top + y1 * side)]
        for y0, y1, x0, x1 in _boxes(picture)
    ]  # fmt: skip
    axes.add_collection(PolyCollection(boxes, facecolors="black", edgecolors="none", antialiaseds=False))
    axes.text(left, paper[1] - 3, _words(board), fontsize=7, color="0.4")
    file = BytesIO()
    figure.savefig(file, format="pdf")
    return file.getvalue()


def _boxes(black: np.ndarray[tuple[int, int], np.dtype[np.bool_]]) -> list[tuple[int, int, int, int]]:
    """Rectangles (top, bottom, left, right) that cover the black pixels: rows that are alike are joined."""
    found = []
    changes = np.flatnonzero((black[1:] != black[:-1]).any(axis=1)) + 1
    for top, bottom in zip([0, *changes], [*changes, len(black)], strict=True):
        line = np.concatenate([[False], black[top], [False]]).astype(np.int8)
        begins, ends = np.flatnonzero(np.diff(line) == 1), np.flatnonzero(np.diff(line) == -1)
        found += [(int(top), int(bottom), int(a), int(b)) for a, b in zip(begins, ends, strict=True)]
    return found
