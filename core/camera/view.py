"""A view as the page writes it in addresses and files: 14 numbers, a camera once the picture has a size."""

from __future__ import annotations

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.camera.camera import Camera, pinhole

COUNT = 14
_MAX_CHARACTERS = 1000
_MAX_NUMBER = 1e9
_MIN_ACROSS = 1e-3  # length of forward x down, below which they do not say how the camera is held


def view_in(text: str) -> Float64 | None:
    """[14] numbers of a text of the page's `state.camera`, or None where it is none.

    They are position, forward and down directions (3 each, world units), distance to what is looked at, focal length
    and principal point as fractions of the picture's height, and the horizontal focal length over the vertical one.
    """
    if len(text) > _MAX_CHARACTERS:
        return None
    try:
        numbers = np.array([float(part) for part in text.split(",", COUNT)])
    except ValueError:
        return None
    return numbers if len(numbers) == COUNT else None


def camera_of_view(name: str, numbers: Float64, size: tuple[int, int]) -> Camera | None:
    """The camera of a view [14] for a picture of (width, height), or None where the numbers are no camera."""
    if not np.all(np.abs(numbers) < _MAX_NUMBER) or not (numbers[10] > 0 and numbers[13] > 0):
        return None
    ahead, across = numbers[3:6], np.cross(numbers[6:9], numbers[3:6])
    if np.linalg.norm(across) < _MIN_ACROSS:
        return None
    forward, right = ahead / np.linalg.norm(ahead), across / np.linalg.norm(across)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return pinhole_of_view(name, rotation, numbers[:3], numbers[10:], size)


def pinhole_of_view(name: str, rotation: Float64, position: Float64, lens: Float64, size: tuple[int, int]) -> Camera:
    """The camera at `position` [3] with the rows right, down and forward in `rotation` [3,3].

    Args:
        lens: [4] focal length, principal point right and down of the middle, horizontal over vertical focal length.
        size: (width, height) of the picture.
    """
    (width, height), (focal, right, down, stretch) = size, lens
    pose = np.concatenate([rotation, (-rotation @ position)[:, None]], axis=1)
    principal = width / 2 + right * height, height / 2 + down * height
    return pinhole(name, (focal * stretch * height, focal * height), principal, size, pose)
