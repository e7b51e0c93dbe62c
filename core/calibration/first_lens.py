"""A first lens of each camera from its own pictures of the board."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from streamlod.core.arrays import Float64, Int64
from streamlod.core.calibration.adjustment.projection import lens_of
from streamlod.core.calibration.instants import cells_of, covering
from streamlod.core.calibration.track import MIN_CORNERS, Track
from streamlod.core.errors import InputError

MIN_PICTURES = 6
_MAX_PICTURES = 30
_FOCAL = (0.25, 6.0)  # widths


def first_lens(track: Track, board: Float64) -> Float64:
    """[9] lens by Zhang's method (OpenCV), with one radial coefficient; adjustment refines it.

    Args:
        board: [J,3] corners in metres.

    Raises:
        InputError: the camera saw the board too rarely, or only flat on, so that its focal length is not known.
    """
    objects, points = chosen_corners(track, board)
    width, height = track.size
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_ASPECT_RATIO
    flags |= cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_USE_INTRINSIC_GUESS
    best: tuple[float, Float64] | None = None
    for focal in (0.6, 0.9, 1.5):  # widths; the search may end beside the truth from one of them
        guess = np.array([[focal * width, 0, (width - 1) / 2], [0, focal * width, (height - 1) / 2], [0, 0, 1]])
        try:
            error, matrix, distortion, _, _ = cv2.calibrateCamera(
                objects, points, (width, height), guess, np.zeros(5), flags=flags
            )
        except cv2.error:
            continue
        if _FOCAL[0] <= matrix[0, 0] / width <= _FOCAL[1] and (best is None or error < best[0]):
            best = float(error), lens_of(np.asarray(matrix, np.float64), np.asarray(distortion, np.float64))
    if best is None:
        raise InputError(
            f"camera {track.camera}",
            "its focal length does not follow from how it saw the board; tilt the board to and fro in front of it",
        )
    return best[1]


def chosen_corners(track: Track, board: Float64) -> tuple[Sequence[Float64], Sequence[Float64]]:
    """Board and picture corners of some pictures that cover what the camera saw."""
    rows = np.flatnonzero(track.seen >= MIN_CORNERS)
    spread = [row for row in rows if _is_spread(track.corners[row])]
    if len(spread) < MIN_PICTURES:
        raise InputError(
            f"camera {track.camera}",
            f"saw the board in {len(spread)} of {len(track.times)} pictures well enough, and needs {MIN_PICTURES}; "
            "walk the board nearer to it, slowly, tilted to and fro",
        )
    chosen = covering([cells_of(track.corners[row], track.size) for row in spread], _MAX_PICTURES)
    pictures = track.corners[np.array(spread)[chosen]]
    known: list[Int64] = [np.flatnonzero(np.isfinite(corners[:, 0])) for corners in pictures]
    objects = [np.asarray(board[row], np.float32) for row in known]
    points = [np.asarray(corners[row], np.float32)[:, None] for corners, row in zip(pictures, known, strict=True)]
    return objects, points  # type: ignore[return-value]


def _is_spread(corners: Float64) -> bool:
    """Whether corners [J,2] do not lie on one line."""
    known = corners[np.isfinite(corners[:, 0])]
    across = np.linalg.svd(known - known.mean(axis=0), compute_uv=False)
    return bool(across[1] > 0.1 * across[0])
