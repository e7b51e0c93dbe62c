"""Known lenses against the pictures of the board that the cameras took: those of another camera are refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment.projection import matrix_of
from streamlod.core.calibration.first_lens import chosen_corners, first_lens
from streamlod.core.calibration.track import Track
from streamlod.core.errors import InputError

_MISFIT, _MISFIT_PIXELS = 1.6, 0.3  # times the misses of a lens from the walk, and pixels, that a known one may miss by
_NOWHERE = 999.0  # pixels, for a lens by which no pose is found


def check_known(tracks: Sequence[Track], lenses: Mapping[str, Float64], board: Float64) -> None:
    """Raise InputError for a camera whose known lens [9] is another camera's, by its own pictures of the board.

    Lenses that are nearly alike pass for each other, and those of cameras that saw too little to tell are believed.
    """
    for track in tracks:
        if track.camera not in lenses:
            continue
        try:
            own = first_lens(track, board)
        except InputError:
            continue
        objects, points = chosen_corners(track, board)
        misses = {name: _miss(lens, objects, points, track.size) for name, lens in lenses.items()}
        stated, best = misses[track.camera], _miss(own, objects, points, track.size)
        limit = max(_MISFIT * best, _MISFIT_PIXELS)
        if stated <= limit:
            continue
        fits = [name for name, miss in misses.items() if miss <= limit]
        nearest = min(fits, key=misses.__getitem__, default=None)
        reason = "it zoomed, or is of another camera"
        if nearest is not None:
            reason = f"that of {nearest} fits, so that names may be exchanged"
        raise InputError(
            f"camera {track.camera}",
            f"its known lens does not fit, as the board's corners lie {stated:.1f} pixels off by it, and {best:.1f} by "
            f"what this walk shows; {reason}; put the lenses right or leave them out",
        )


def _miss(lens: Float64, objects: Sequence[Float64], points: Sequence[Float64], size: tuple[int, int]) -> float:
    """Pixels by which corners lie off by a lens that is kept, the median of the pictures: of few, no pose is found."""
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_FOCAL_LENGTH | cv2.CALIB_FIX_PRINCIPAL_POINT
    flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_TANGENT_DIST
    try:
        found = cv2.calibrateCameraExtended(objects, points, size, matrix_of(lens), lens[4:].copy(), flags=flags)
    except cv2.error:
        return _NOWHERE
    return min(float(np.median(found[-1])), _NOWHERE)
