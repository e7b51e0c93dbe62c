"""The track of the board in one camera's footage, and why there is none."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import islice

import numpy as np

from streamlod.core.arrays import UInt8
from streamlod.core.calibration.board.description import Board
from streamlod.core.calibration.board.detect import Detector, variants
from streamlod.core.calibration.track import MIN_CORNERS, Track
from streamlod.core.calibration.walk import WalkFootage
from streamlod.core.errors import InputError

_log = logging.getLogger(__name__)
_MAX_RATE = 32.0  # pictures a second that are searched: a person with a board is not faster
_MAX_PICTURES = 5400  # of a camera: three minutes
_SAMPLES = 16
_FEW = 3  # pictures with the board below which the reason is looked for
_RARELY = 0.3  # part of the pictures with the board below which they may be mirrored, of which some are misread
_DOUBLED = 0.1  # part of the pictures in which a marker may be seen twice, by a mirror or a misreading


def board_as_seen(footage: Sequence[WalkFootage], board: Board) -> Board:
    """The board as described where the pictures show it, else the variant (inverted, legacy) that most of them show.

    Raises:
        InputError: no camera sees it, for a reason that is named where it can be found.
    """
    pictures = [picture for each in footage for picture in _sampled(each)]
    if _corners(pictures, board) >= MIN_CORNERS * len(footage):
        return board
    counts = {variant: _corners(pictures, variant) for variant in variants(board)}
    best = max(counts, key=counts.__getitem__)
    if counts[best] < MIN_CORNERS:
        raise InputError("board", _why_unseen(pictures, board))
    if best != board:
        _log.warning("the board is taken as inverted = %s, legacy_pattern = %s", best.inverted, best.legacy)
    return best


def track_of(footage: WalkFootage, board: Board, on_picture: Callable[[], object] = lambda: None) -> Track:
    """The corners that one camera saw.

    Args:
        board: as some camera saw it (`board_as_seen`), so that it is described well.
        on_picture: called for each picture that was searched.

    Raises:
        InputError: it hardly saw the board, or two boards, or one with more markers.
    """
    detect, step = Detector(board), picture_step(footage)
    rows, corners, doubled, foreign = [], [], 0, Counter[int]()
    for row, picture in enumerate(footage.pictures()):
        if row % step or picture is None or picture.shape[1::-1] != footage.size:
            continue
        sighting = detect(picture)
        rows.append(row)
        corners.append(sighting.corners)
        ids, counts = np.unique(sighting.markers, return_counts=True)
        doubled += (counts > 1).sum() > 1  # one alone is something in the room
        foreign.update(int(marker) for marker in ids if marker >= board.marker_count)
        on_picture()
    _check_one_board(footage.camera, board, len(rows), doubled, foreign)
    shape = len(rows), board.corner_count, 2
    track = Track(footage.camera, footage.size, footage.times[rows], np.reshape(corners, shape).astype(np.float64))
    seen = track.seen >= MIN_CORNERS
    if seen.sum() < max(_FEW, _RARELY * len(rows)):
        pictures = list(_sampled(footage))
        if seen.sum() < _FEW or _corners(pictures, board, mirrored=True) > _corners(pictures, board):
            fault = _why_mirrored_or_far(pictures, board, _markers(pictures, board))
            fault = fault or "hardly sees the board; walk longer, facing it, nearer to it and slower, with more light"
            raise InputError(f"camera {footage.camera}", fault)
    return track


def picture_step(footage: WalkFootage) -> int:
    """Every how manieth picture of a camera is searched."""
    seconds = max(1e-3, float(footage.times[-1] - footage.times[0])) if len(footage.times) else 1.0
    return max(1, int(len(footage.times) / seconds / _MAX_RATE + 0.5), -(-len(footage.times) // _MAX_PICTURES))


def _check_one_board(camera: str, board: Board, count: int, doubled: int, foreign: Counter[int]) -> None:
    if doubled > max(_FEW, _DOUBLED * count):
        raise InputError(
            f"camera {camera}", f"sees two boards at once in {doubled} of {count} pictures; walk with one board alone"
        )
    often = [marker for marker, times in foreign.items() if times > max(_FEW, _DOUBLED * count)]
    if len(often) > 1:  # one alone is something in the room, as a brick or a toy, that is taken for a marker
        raise InputError(
            "board",
            f"camera {camera} sees its marker {max(often)}, but a board of {board.columns}x{board.rows} squares has "
            f"markers 0 to {board.marker_count - 1}; count the squares of yours and give them with --board",
        )


def _sampled(footage: WalkFootage) -> Iterable[UInt8]:
    """A few pictures from all of a camera's time."""
    step = max(1, len(footage.times) // _SAMPLES)
    return (picture for picture in islice(footage.pictures(), 0, None, step) if picture is not None)


def _corners(pictures: Sequence[UInt8], board: Board, *, mirrored: bool = False) -> int:
    """Corners of the board in all pictures together."""
    detect = Detector(board)
    return sum(detect(np.ascontiguousarray(each[:, ::-1]) if mirrored else each).count for each in pictures)


def _markers(pictures: Sequence[UInt8], board: Board) -> list[list[int]]:
    """The markers that are read in each picture."""
    detect = Detector(board)
    return [detect(picture).markers.tolist() for picture in pictures]


def _why_unseen(pictures: Sequence[UInt8], board: Board) -> str:
    """One sentence about a board that no camera shows as described."""
    at_once = _markers(pictures, board)
    if reason := _why_mirrored_or_far(pictures, board, at_once):
        return reason
    markers = [marker for seen in at_once for marker in seen]
    if len(markers) < 2 * _FEW:
        return (
            f"no board of {board.columns}x{board.rows} squares with markers of {board.dictionary} is seen; "
            "hold it nearer to the cameras and slower, with more light, or describe yours with --board"
        )
    turned = Board(board.rows, board.columns, board.square_m, board.marker_ratio, board.dictionary, board.inverted)
    other = board.columns != board.rows and max(markers) >= 0.75 * board.marker_count
    if other and _corners(pictures, turned) >= MIN_CORNERS:
        return f"has {board.rows}x{board.columns} squares, not {board.columns}x{board.rows}; exchange columns and rows"
    return (
        f"its markers are seen (0 to {max(markers)}), but do not lie as on a board of "
        f"{board.columns}x{board.rows} squares; count the squares of yours and give them with --board"
    )


def _why_mirrored_or_far(pictures: Sequence[UInt8], board: Board, at_once: Sequence[Sequence[int]]) -> str:
    """One sentence where the pictures show the board mirrored, or some of its markers alone; else nothing.

    Args:
        at_once: the markers that are read in each picture.
    """
    if any(_corners(pictures, variant, mirrored=True) >= MIN_CORNERS for variant in variants(board)[:2]):
        return "its pictures show the board mirrored; switch the mirroring of the camera off, or print the board anew"
    markers = [marker for seen in at_once for marker in seen]
    most = max((len(set(seen)) for seen in at_once), default=0)
    if len(markers) >= 2 * _FEW and 2 * most <= max(markers) + 1:
        return (
            f"at most {most} of the board's markers are read in one picture, too few for its corners; "
            "hold it nearer to the camera and slower, with more light"
        )
    return ""
