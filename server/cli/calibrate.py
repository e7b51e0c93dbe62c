"""The command `streamlod calibrate`; returns the text to print."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from streamlod.core.calibration.board.description import FILE, Board, board_text, read_board
from streamlod.core.errors import InputError
from streamlod.core.files import write_text
from streamlod.core.progress_bar import progress_bar

if TYPE_CHECKING:
    from streamlod.core.arrays import Float64
    from streamlod.core.calibration.track import Track
    from streamlod.core.calibration.walk import WalkFootage

_PICTURE = "calibration.png"
REPORT = "calibration.txt"


def print_board(path: Path, board: str | None, square_mm: float | None) -> str:
    """Write the board for printing, and its description beside it."""
    from streamlod.core.calibration.board.printing import PAPERS, fitted_to
    from streamlod.core.calibration.board.printing import print_board as write

    described = board_of(board, square_mm, path.parent, beside=False)
    if square_mm is None and path.stem.upper() in PAPERS and not _is_file(board):
        described = fitted_to(described, path.stem.upper())
    paper = write(described, path)
    beside = path.with_name(FILE)
    write_text(beside, board_text(described))
    return (
        f"{path}: {described.described()} on {paper}; print it at 100 %, measure a square, and calibrate with "
        f"--board {beside} (--square-mm where it measures otherwise)"
    )


def calibrate(
    data: Path, out: Path | None, board: str | None, square_mm: float | None, lenses: Path | None, overwrite: bool
) -> str:
    """Calibrate the cameras of a board walk."""
    from streamlod.core.calibration.board.seen import board_as_seen
    from streamlod.core.calibration.files import check_folder, write_calibration
    from streamlod.core.calibration.report import advice_of, draw, table_of
    from streamlod.core.calibration.solve import calibrate as solve
    from streamlod.core.calibration.sound.report import sound_advice
    from streamlod.core.calibration.sound.walk import walk_offsets
    from streamlod.core.calibration.walk import open_walk

    described, folder = board_of(board, square_mm, data), data if out is None else out
    footage = open_walk(data)
    known = {} if lenses is None else known_lenses(lenses, footage)
    check_folder(folder, overwrite=overwrite)
    seen = board_as_seen(footage, described)
    found = solve(_tracks(footage, seen), seen, known, walk_offsets(footage))
    files = write_calibration(found, footage, folder)
    board_line = f"the board has {seen.described()}, from which all lengths follow"
    report = "\n".join([table_of(found), *sound_advice(found), *advice_of(found), board_line])
    write_text(folder / REPORT, report + "\n")
    draw(found, folder / _PICTURE)
    return f"{report}\n{', '.join(file.name for file in files)}, {REPORT} and {_PICTURE} written to {folder}"


def _tracks(footage: Sequence[WalkFootage], board: Board) -> list[Track]:
    from streamlod.core.calibration.board.seen import picture_step, track_of

    total = sum(-(-len(each.times) // picture_step(each)) for each in footage)
    pool = ThreadPoolExecutor(min(len(footage), os.cpu_count() or 1), "detect")
    with progress_bar(total=total, unit="picture", desc="looking for the board") as bar, pool:
        return list(pool.map(lambda each: track_of(each, board, bar.update), footage))


def _is_file(board: str | None) -> bool:
    return board is not None and board.endswith(".toml")


def board_of(board: str | None, square_mm: float | None, folder: Path, *, beside: bool = True) -> Board:
    """The board that the options describe, or charuco.toml with the videos or beside their folder, or the usual one."""
    found = Board()
    if board is not None and _is_file(board):
        found = read_board(Path(board))
    elif board is not None:
        match = re.fullmatch(r"(\d{1,3})x(\d{1,3})", board)
        if match is None:
            raise InputError("--board", f"{board!r:.60} is neither COLUMNSxROWS, such as 7x5, nor a .toml file")
        found = replace(found, columns=int(match[1]), rows=int(match[2]))
    elif beside:
        files = (place / FILE for place in (folder, folder.absolute().parent))
        found = next((read_board(file) for file in files if file.is_file()), found)
    return found if square_mm is None else replace(found, square_m=square_mm / 1000)


def known_lenses(folder: Path, footage: Sequence[WalkFootage]) -> dict[str, Float64]:
    """Lenses by camera's name of a calibrated recording, whose pictures have the size of the walk's."""
    from streamlod.core.calibration.adjustment.projection import lens_of
    from streamlod.core.data import open_dataset
    from streamlod.core.data.lens import opencv_matrix

    cameras = open_dataset(folder).recording.cameras
    sizes = {each.camera: each.size for each in footage}
    for camera in cameras:
        width, height = sizes.get(camera.name, size := (camera.width, camera.height))
        if (width, height) != size:
            raise InputError(
                f"camera {camera.name}",
                f"its lens in {folder} is for {size[0]}x{size[1]}, and the walk has {width}x{height}; film in one size",
            )
    return {camera.name: lens_of(opencv_matrix(camera), camera.distortion) for camera in cameras}
