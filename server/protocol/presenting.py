"""Messages of viewers that watch together: one shows where it looks and at what moment, others follow.

What is shown goes on to all who follow, so only known fields with bounded numbers are kept of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError
from streamlod.server.protocol.fields import numbers
from streamlod.server.protocol.packets import Position

_MAX_COORDINATE = 1e9  # world units
_MIN_LENGTH, _MAX_LENGTH = 1e-6, 1e9
_MAX_RATIO = 1e3  # of lengths in the picture
_SLACK = 1e-3  # of a rotation's rows
_MAX_NUMBER = 2**32 - 1
_MODES = ("live", "replay", "paused")


@dataclass(frozen=True, slots=True)
class Moment:
    """When a presenter looks: at the live edge, or at a position from which it goes on or where it stands still."""

    mode: str
    position: Position | None

    def to_json(self) -> dict[str, Any]:
        """The moment as a field of a message."""
        return {"mode": self.mode, **({} if self.position is None else self.position.to_json())}


@dataclass(frozen=True, slots=True)
class Present:
    """Shows a view and a moment to all who follow; without a view, shows nothing any more."""

    view: dict[str, Any] | None
    at: Moment | None

    @property
    def shown(self) -> dict[str, Any]:
        """Fields of the event that tells followers; empty where nothing is shown any more."""
        return {} if self.view is None or self.at is None else {"view": self.view, "at": self.at.to_json()}

    def to_json(self) -> dict[str, Any]:
        """The message."""
        return {"type": "present", "view": None, **self.shown}


@dataclass(frozen=True, slots=True)
class Follow:
    """Asks to be told what a presenter shows, or no longer."""

    on: bool


def parse_presenting(message: dict[str, Any]) -> Present | Follow:
    """A `present` or `follow` message.

    Raises:
        SessionError: 4400, it is malformed, or its numbers are out of bounds.
    """
    if message.get("type") == "follow":
        on = message.get("on")
        if not isinstance(on, bool):
            raise SessionError(CloseCode.BAD_MESSAGE, "on must be true or false")
        return Follow(on)
    view = message.get("view")
    return Present(None, None) if view is None else Present(_view(view), _moment(message.get("at")))


def _view(view: object) -> dict[str, Any]:
    if not isinstance(view, dict):
        raise SessionError(CloseCode.BAD_MESSAGE, "view must be an object or null")
    rotation = numbers(view, "rotation", 9, 1 + _SLACK)
    rows = np.array(rotation).reshape(3, 3)
    if np.abs(rows @ rows.T - np.eye(3)).max() > _SLACK or np.linalg.det(rows) < 0:
        raise SessionError(CloseCode.BAD_MESSAGE, "rotation must be a rotation")
    return {
        "position": numbers(view, "position", 3, _MAX_COORDINATE),
        "rotation": rotation,
        "distance": _length(view, "distance", _MIN_LENGTH, _MAX_LENGTH),
        "focal": _length(view, "focal", 1 / _MAX_RATIO, _MAX_RATIO),
        "stretch": _length(view, "stretch", 1 / _MAX_RATIO, _MAX_RATIO),
        "shift": numbers(view, "shift", 2, _MAX_RATIO),
    }


def _length(view: dict[str, Any], name: str, least: float, most: float) -> float:
    (value,) = numbers({name: [view.get(name)]}, name, 1, most)
    if value < least:
        raise SessionError(CloseCode.BAD_MESSAGE, f"{name} must be at least {least:g}")
    return value


def _moment(at: object) -> Moment:
    if not isinstance(at, dict) or at.get("mode") not in _MODES:
        raise SessionError(CloseCode.BAD_MESSAGE, "at must be an object whose mode is live, replay or paused")
    if at["mode"] == "live":
        return Moment("live", None)
    epoch, version = at.get("epoch"), at.get("version")
    if type(epoch) is int and type(version) is int and max(epoch, version) <= _MAX_NUMBER and min(epoch, version) >= 0:
        return Moment(at["mode"], Position(epoch, version))
    raise SessionError(CloseCode.BAD_MESSAGE, "at must name an epoch and a version")
