"""The camera and moment that a presenter shows to those who follow. docs/protocol.md, "Together"."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from streamlod.client.events import Notice
from streamlod.core.camera import Camera
from streamlod.core.camera.view import pinhole_of_view
from streamlod.core.errors import InputError

_MAX = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Presented:
    """The view of a presenter.

    Attributes:
        by: its session.
        camera: where it looks from, for a picture of the size that was asked for.
        mode: "live", "replay" or "paused".
        position: (epoch, version) where it looks; None at the live edge.
    """

    by: str
    camera: Camera
    mode: str
    position: tuple[int, int] | None


def presented(notice: Notice, size: tuple[int, int]) -> Presented | None:
    """The view that a `presenter` event shows; None where nobody presents.

    Args:
        size: width and height in pixels of the picture to draw.

    Raises:
        InputError: the event holds no view that a camera can have.
    """
    by, view, at = (notice.fields.get(name) for name in ("by", "view", "at"))
    if not isinstance(by, str) or not isinstance(view, dict):
        return None
    rotation = np.array(_numbers(view, "rotation", 9)).reshape(3, 3)
    position = np.array(_numbers(view, "position", 3))
    focal, stretch = (_numbers({name: [view.get(name)]}, name, 1)[0] for name in ("focal", "stretch"))
    lens = np.array([focal, *_numbers(view, "shift", 2), stretch])
    camera = pinhole_of_view("presenter", rotation, position, lens, size)
    mode, place = _moment(at)
    return Presented(by, camera, mode, place)


def _numbers(view: dict[str, Any], name: str, count: int) -> list[float]:
    values = view.get(name)
    if not isinstance(values, list) or len(values) != count:
        raise InputError("presenter", f"shows a view without {count} numbers of {name}")
    for value in values:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not math.isfinite(value) or abs(value) > _MAX:
            raise InputError("presenter", f"shows a view whose {name} is out of range")
    return [float(value) for value in values]


def _moment(at: object) -> tuple[str, tuple[int, int] | None]:
    found = at if isinstance(at, dict) else {}
    mode, epoch, version = (found.get(name) for name in ("mode", "epoch", "version"))
    if mode in ("replay", "paused") and type(epoch) is int and type(version) is int:
        return mode, (epoch, version)
    if mode != "live":
        raise InputError("presenter", "shows a moment that is neither live nor a position")
    return "live", None
