"""A drawing in letters: the space that the rig looks at from above, and how many cameras see each place of it."""

from __future__ import annotations

import string
from collections.abc import Sequence

import numpy as np

from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.checks.coverage import Coverage, is_seen_by
from streamlod.core.calibration.world import axes_of, up_of
from streamlod.core.camera import Camera

_COLUMNS, _LEAST_ROWS, _MOST_ROWS = 56, 5, 26
_TALL = 2.0  # a letter is so many times as tall as it is wide
_MARGIN = 0.05  # of the extent, on each side
_LETTERS = string.ascii_uppercase + string.ascii_lowercase
_SEVERAL = "*"
_MOST = 9  # cameras that one digit can tell


def drawn_from_above(coverage: Coverage, cameras: Sequence[Camera]) -> str:
    """Lines of text: digits tell how many of the cameras see a place at the height of the middle, letters are cameras.

    On average the cameras look up the drawing; `.` is a place that none sees.
    """
    to_world = np.array([rigid.pose(camera.world_to_camera) for camera in cameras])
    to_plan = axes_of(to_world, up_of(to_world), coverage.centre)
    turn, move = rigid.rotations(to_plan[None, :3])[0], to_plan[3:]
    stand = np.array([turn @ camera.centre + move for camera in cameras])[:, :2]
    shown = np.concatenate([stand, [[-coverage.radius] * 2, [coverage.radius] * 2]])
    low, high = shown.min(axis=0), shown.max(axis=0)
    margin = _MARGIN * float((high - low).max())
    low, high = low - margin, high + margin
    # as fine as the columns allow, but no more rows than a terminal shows
    wide = max(float(high[0] - low[0]) / _COLUMNS, float(high[1] - low[1]) / (_TALL * _MOST_ROWS), 1e-9)
    columns = max(1, int(np.ceil((high[0] - low[0]) / wide)))
    rows = max(_LEAST_ROWS, int(np.ceil((high[1] - low[1]) / (_TALL * wide))))
    cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
    flat = np.array([low[0], high[1]]) + (cells + 0.5) * [wide, -_TALL * wide]
    places = (np.concatenate([flat, np.zeros((rows, columns, 1))], axis=2).reshape(-1, 3) - move) @ turn
    counts = np.sum([is_seen_by(camera, places) for camera in cameras], axis=0).reshape(rows, columns)
    drawn = [[str(min(int(count), _MOST)) if count else "." for count in row] for row in counts]
    letters = [*_LETTERS[: len(cameras)], *_SEVERAL * (len(cameras) - len(_LETTERS))]
    stands = np.floor(np.abs(stand - [low[0], high[1]]) / [wide, _TALL * wide]).astype(np.int64)
    for letter, (column, row) in zip(letters, stands.tolist(), strict=True):
        drawn[row][column] = _SEVERAL if drawn[row][column] in {*letters, _SEVERAL} else letter
    names = ", ".join(f"{letter} {camera.name}" for letter, camera in zip(letters, cameras, strict=True))
    return "\n".join(
        [
            "from above, at the height of the middle: how many cameras see each place (. none), and where they stand",
            *("".join(row).rstrip() for row in drawn),
            f"{names}; a letter is {wide:.2g} wide and {_TALL * wide:.2g} deep, in metres after a board walk",
        ]
    )
