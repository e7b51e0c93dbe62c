"""How far what a camera sees has moved in its picture since an earlier one: a knocked camera, seen by itself.

What stands still shows its features where they were, whatever else moves and however it is lit. Only where nearly none
is still in its place, and most of those found again follow one homography, as all do that a turned camera sees, has the
picture moved. Anything between says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from streamlod.core.arrays import UInt8
from streamlod.core.calibration.checks.matches import Features, alike, features_of

OFF = 3.0  # pixels at a width of 1000, from which a camera counts as moved
_SIDE = 200  # pixels of the longer side of what is looked at; larger pictures take longer and tell no more
_MOST = 200  # features
_STILL, _MOVED = 10, 15  # the fewest that say so; chance brings a dozen under one homography
_STILL_SHARE, _MOVED_SHARE, _MAJORITY = 0.25, 0.3, 3


@dataclass(frozen=True, slots=True)
class Shift:
    """How far a picture has moved: the median in pixels at a width of 1000, and how many features were found again."""

    pixels: float
    matches: int


def landmarks(picture: UInt8) -> Features:
    """The features of a picture [H,W,3] by which it is compared with others, in pixels at a width of 1000."""
    height, width = picture.shape[:2]
    scale = min(1.0, _SIDE / max(height, width))
    size = max(round(scale * width), 1), max(round(scale * height), 1)
    small = picture if scale == 1 else cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    found = features_of(np.asarray(small, np.uint8), _MOST)
    return Features(found.points * (1000 / small.shape[1]), found.descriptors)


def shift(before: Features, now: Features) -> Shift | None:
    """How far the picture has moved between two `landmarks`; None where they do not tell."""
    pairs = alike(before, now)
    if (count := len(pairs)) < _STILL:
        return None
    there, here = before.points[pairs[:, 0]], now.points[pairs[:, 1]]
    moves = np.linalg.norm(here - there, axis=1)
    still = moves < OFF
    if still.sum() >= max(_STILL, _STILL_SHARE * count):
        return Shift(float(np.median(moves[still])), count)
    if count < _MOVED:
        return None
    mask = cv2.findHomography(there, here, cv2.USAC_MAGSAC, OFF)[1]
    together = np.zeros(count, np.bool_) if mask is None else np.ravel(mask).astype(np.bool_)
    if together.sum() < max(_MOVED, _MOVED_SHARE * count, _MAJORITY * still.sum()):
        return None
    return Shift(float(np.median(moves[together])), count)
