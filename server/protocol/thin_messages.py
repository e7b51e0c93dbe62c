"""Messages of thin viewers, which get pictures: the camera they look through, the picture on screen, a ray to pick.

All numbers are checked against limits first, because they decide how much the server computes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera, pinhole
from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import InputError, SessionError
from streamlod.server.protocol.fields import numbers, whole

_MAX_SIDE = 8192  # pixels
_MAX_COORDINATE = 1e9  # world units
_FOCAL = (0.05, 50.0)  # fractions of the longer side


@dataclass(frozen=True, slots=True, eq=False)
class ViewMessage:
    """The camera to draw from, with the size of the viewer's canvas."""

    camera: Camera


@dataclass(frozen=True, slots=True)
class Shown:
    """Number of the newest picture that is on the screen."""

    picture: int


@dataclass(frozen=True, slots=True, eq=False)
class Pick:
    """Asks what lies along a ray: `origin` [3], unit vector `direction` [3], world units; the answer repeats `id`."""

    id: int
    origin: Float64
    direction: Float64


def parse_view_message(message: dict[str, Any]) -> ViewMessage | Shown | Pick:
    """An `ack` that names a picture, a `view` or a `pick` message.

    Raises:
        SessionError: 4400, it is malformed, or its numbers are out of bounds.
    """
    match message["type"]:
        case "view":
            return _view(message)
        case "pick":
            return _pick(message)
    return Shown(whole(message.get("picture"), "picture"))


def _view(message: dict[str, Any]) -> ViewMessage:
    size = _side(message.get("width"), "width"), _side(message.get("height"), "height")
    focal, principal = numbers(message, "focal", 2, 1e6), numbers(message, "principal", 2, 1e6)
    if not all(_FOCAL[0] <= value / max(size) <= _FOCAL[1] for value in focal):
        raise SessionError(CloseCode.BAD_MESSAGE, f"focal must be {_FOCAL[0]:g} to {_FOCAL[1]:g} times the longer side")
    rotation = np.array(numbers(message, "rotation", 9, 1.01)).reshape(3, 3)
    position = np.array(numbers(message, "position", 3, _MAX_COORDINATE))
    pose = np.concatenate([rotation, -rotation @ position[:, None]], axis=1)
    try:
        return ViewMessage(pinhole("viewer", (focal[0], focal[1]), (principal[0], principal[1]), size, pose))
    except InputError as error:
        raise SessionError(CloseCode.BAD_MESSAGE, error.fault) from error


def _pick(message: dict[str, Any]) -> Pick:
    origin = np.array(numbers(message, "origin", 3, _MAX_COORDINATE))
    direction = np.array(numbers(message, "direction", 3, 2.0))
    length = float(np.linalg.norm(direction))
    if length < 1e-3:
        raise SessionError(CloseCode.BAD_MESSAGE, "direction must not be zero")
    return Pick(whole(message.get("id"), "id"), origin, direction / length)


def _side(value: object, name: str) -> int:
    if type(value) is not int or not 1 <= value <= _MAX_SIDE:
        raise SessionError(CloseCode.BAD_MESSAGE, f"{name} must be an integer from 1 to {_MAX_SIDE}")
    return value
