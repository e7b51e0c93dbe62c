"""First poses: the board in each camera, pairs of cameras that see it together, and the tree that joins all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.adjustment.projection import matrix_of
from streamlod.core.calibration.apart import MIN_SHARED, apart
from streamlod.core.calibration.track import MIN_CORNERS, Track

_MAX_ERROR = 10.0  # pixels, of a board before adjustment
_AGREE = 10.0  # degrees within which views of one pair of cameras agree


@dataclass(frozen=True, slots=True, eq=False)
class FirstPoses:
    """Poses before adjustment.

    Attributes:
        root: number of the camera whose axes are the world's.
        cameras: [C,6] world to camera.
        boards: [I,6] board to world; NaN where no camera saw it.
        views: for each camera [I,6] board to camera, by what it saw alone; NaN where it did not.
    """

    root: int
    cameras: Float64
    boards: Float64
    views: tuple[Float64, ...]


def board_poses(corners: Float64, lens: Float64, board: Float64) -> Float64:
    """[I,6] board to camera from corners [I,J,2] of one camera; NaN where too few are seen."""
    matrix, poses = matrix_of(lens), np.full((len(corners), 6), np.nan)
    for number, points in enumerate(corners):
        known = np.isfinite(points[:, 0])
        if known.sum() < MIN_CORNERS:
            continue
        try:
            found, turns, moves, errors = cv2.solvePnPGeneric(
                board[known], points[known], matrix, lens[4:], flags=cv2.SOLVEPNP_IPPE
            )
        except cv2.error:  # corners on one line
            continue
        if not found:  # and then there are no lists
            continue
        options = [
            (float(np.ravel(error)[0]), np.concatenate([np.ravel(turn), np.ravel(move)]))
            for turn, move, error in zip(turns[:found], moves, errors, strict=False)
        ]
        usable = [each for each in options if np.isfinite(each[1]).all() and each[1][5] > 0 and each[0] < _MAX_ERROR]
        if usable:
            poses[number] = min(usable, key=lambda each: each[0])[1]
    return poses


def first_poses(
    tracks: Sequence[Track], offsets: Float64, times: Float64, lenses: Float64, board: Float64
) -> FirstPoses:
    """Poses of all cameras, chained along the pairs that saw the board together most often.

    Args:
        offsets: [C] seconds from each camera's clock to the common time. times: [I] common seconds of the instants.
        lenses: [C,9]. board: [J,3] corners in metres.

    Raises:
        InputError: cameras that hardly saw the board together with the others, named, with the cause.
    """
    views = [
        board_poses(track.near(times - offset).at(times - offset), lens, board)
        for track, offset, lens in zip(tracks, offsets, lenses, strict=True)
    ]
    count = len(tracks)
    shared = np.zeros((count, count))
    between: dict[tuple[int, int], Float64] = {}
    for a, b in combinations(range(count), 2):
        both = np.flatnonzero(np.isfinite(views[a][:, 0]) & np.isfinite(views[b][:, 0]))
        if not len(both):
            continue
        from_a_to_b, away = rigid.median_pose(rigid.after(views[b][both], rigid.inverse(views[a][both])))
        shared[a, b] = shared[b, a] = int((away < _AGREE).sum())
        between[a, b], between[b, a] = from_a_to_b, rigid.inverse(from_a_to_b)[0]
    root = int(shared.sum(axis=1).argmax())
    placed = {root: rigid.IDENTITY}
    while len(placed) < count:
        ways = [(shared[a, b], a, b) for a in placed for b in range(count) if b not in placed]
        most, a, b = max(ways)
        if most < MIN_SHARED:
            raise apart(tracks, offsets, set(placed), int(most), board)
        placed[b] = rigid.after(between[a, b], placed[a])[0]
    cameras = np.array([placed[number] for number in range(count)])
    return FirstPoses(root, cameras, _boards(views, cameras), tuple(views))


def _boards(views: Sequence[Float64], cameras: Float64) -> Float64:
    """[I,6] board to world: of the cameras' opinions at each instant, the one that the others agree with best."""
    opinions = np.stack([rigid.after(rigid.inverse(camera), view) for camera, view in zip(cameras, views, strict=True)])
    boards = np.full(opinions.shape[1:], np.nan)
    for instant in range(opinions.shape[1]):
        known = opinions[np.isfinite(opinions[:, instant, 0]), instant]
        if len(known):
            spread = [float(rigid.angles(each, known).sum() + np.abs(known[:, 3:] - each[3:]).sum()) for each in known]
            boards[instant] = known[int(np.argmin(spread))]
    return boards
