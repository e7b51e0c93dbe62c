"""Refusals of what cannot be trusted, each naming the camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from streamlod.core.arrays import Bool, Float64, Int64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.adjustment.adjust import Adjusted, spread
from streamlod.core.calibration.adjustment.observations import Observations
from streamlod.core.camera import Camera
from streamlod.core.data.lens import undistorted_camera
from streamlod.core.errors import InputError

_OUTLIER, _SCATTERS = 1.5, 5.0  # pixels, and times the camera's scatter, from which a corner is an outlier
_FAR = 6.0  # pixels, of a corner that is not where the other cameras say
_MOST_FAR = 0.3  # part of a camera's corners
_MOVED, _MOST_OFF = 6, 0.75  # instants at an end of what a camera saw, and part of them whose corners are far
_MAX_DEGREES, _MAX_PART = 3.0, 0.05  # standard errors: of the direction, and of the place as a part of the distance
_MAX_RMS = 3.0  # pixels


def near_enough(misses: Float64, cameras: Int64) -> Bool:
    """[N] the corners of `cameras` [N] that are no outliers, which a marker read wrongly or blur makes.

    Each camera has a scatter of its own: corners between the pictures of a slow one are known less well.
    """
    distances, most = np.linalg.norm(misses, axis=1), np.full(len(misses), _OUTLIER)
    for number in np.unique(cameras):
        mine = cameras == number
        most[mine] = max(_OUTLIER, _SCATTERS * spread(misses[mine]))
    return np.asarray(distances < most, np.bool_)


def check_agreement(names: Sequence[str], seen: Observations, misses: Float64) -> None:
    """Raise InputError for a camera whose corners lie elsewhere than the others say, all along or from some time on."""
    distances = np.linalg.norm(misses, axis=1)
    far = distances > _FAR
    parts = np.bincount(seen.camera, far, len(names)) / np.maximum(np.bincount(seen.camera, minlength=len(names)), 1)
    worst = int(parts.argmax())
    if parts[worst] > _MOST_FAR:
        raise InputError(
            f"camera {names[worst]}",
            f"does not agree with the others: {100 * parts[worst]:.0f} % of its corners lie more than {_FAR:g} pixels "
            "off; it moved, its video is of another walk, there are two boards, or its times are wrong",
        )
    ends: list[tuple[int, int, str]] = []
    for number in range(len(names)):
        mine = seen.camera == number
        instants = seen.instant[mine]
        off = np.array([np.median(distances[mine][instants == each]) > _FAR for each in np.unique(instants)])
        ends += [(_most_of(run), number, where) for where, run in (("last", off[::-1]), ("first", off))]
    count, number, where = max(ends)
    if count >= _MOVED:
        raise InputError(
            f"camera {names[number]}",
            f"does not agree with the others at the {where} {count} instants at which it saw the board; it was knocked "
            "or turned during the walk: film the walk again and leave the cameras alone",
        )


def _most_of(off: Bool) -> int:
    """How many of the first instants of `off` [N] one can take so that most of them are off."""
    parts = np.cumsum(off) / np.arange(1, len(off) + 1)
    return int(np.flatnonzero(parts >= _MOST_OFF)[-1]) + 1 if (parts >= _MOST_OFF).any() else 0


def check_certainty(names: Sequence[str], adjusted: Adjusted, seen: Observations) -> None:
    """Raise InputError for a camera whose place does not follow from what it saw."""
    scene = adjusted.scene
    away = scene.boards[:, 3:].mean(axis=0) - rigid.inverse(scene.cameras)[:, 3:]
    metres = np.maximum(0.5, np.linalg.norm(away, axis=1))
    bounds = np.stack([np.full(len(names), np.radians(_MAX_DEGREES)), _MAX_PART * metres], axis=1)
    excess = (adjusted.errors / bounds).max(axis=1)
    worst = int(excess.argmax())  # the rig's middle goes with it, and so others may seem uncertain too
    if not excess[worst] <= 1:
        radians, off = adjusted.errors[worst]
        known = f": its place is uncertain by {1000 * off:.0f} mm and {np.degrees(radians):.2f} degrees"
        raise InputError(
            f"camera {names[worst]}",
            f"saw too little of the board{known if off < metres[worst] else ' to be placed at all'}; "
            "walk the board through more of its picture, together with another camera",
        )
    for number, name in enumerate(names):
        mine = seen.camera == number
        rms = float(np.sqrt((adjusted.misses[mine] ** 2).sum(axis=1).mean())) if mine.any() else np.inf
        if rms > _MAX_RMS:
            raise InputError(
                f"camera {name}",
                f"its corners lie {rms:.1f} pixels off; its lens bends more than five coefficients describe, or the "
                "board is not flat",
            )


def check_lens(camera: Camera, advice: str) -> None:
    """Raise InputError, with `advice`, for a lens whose distortion cannot be undone over the whole picture."""
    try:
        undistorted_camera(camera)
    except InputError as error:
        raise InputError(f"camera {camera.name}", f"its lens does not follow from {advice}") from error
