"""Facts about a scene that no decoding depends on: unit, upright direction, time, origin, title, exposures."""

from __future__ import annotations

import math
import unicodedata
from dataclasses import dataclass, fields

from streamlod.core.scene.exposures import CameraExposure

MAX_TEXT_BYTES = 1024
_MAX_NUMBER = 1e12
_MIN_LENGTH = 1e-12


@dataclass(frozen=True, slots=True)
class Original:
    """The similarity that leads from a scene's coordinates x to those of its calibration: scale * R x + translation.

    Attributes:
        scale: positive. rotation: quaternion w x y z of R, of any length but 0. translation: [3].
    """

    scale: float
    rotation: tuple[float, float, float, float]
    translation: tuple[float, float, float]

    def __post_init__(self) -> None:
        _check_length("scale", self.scale)
        _check_direction("rotation", self.rotation)
        _check_numbers("translation", self.translation)


@dataclass(frozen=True, slots=True)
class Metadata:
    """Facts about a scene; None for what is not known.

    Attributes:
        metres_per_unit: length of a world unit.
        up: direction away from the ground, in world coordinates, of any length but 0.
        epoch_ns: nanoseconds from 1970 (UTC) to presentation time 0.
        title, licence: one line of text; a licence is an SPDX expression or an address.
        original: leads back to the coordinates of the calibration.
        exposures: of the rig's cameras, in the order of the scene's header.

    Raises:
        ValueError: a value out of range.
    """

    metres_per_unit: float | None = None
    up: tuple[float, float, float] | None = None
    epoch_ns: int | None = None
    title: str | None = None
    licence: str | None = None
    original: Original | None = None
    exposures: tuple[CameraExposure, ...] | None = None

    def __post_init__(self) -> None:
        if self.metres_per_unit is not None:
            _check_length("metres_per_unit", self.metres_per_unit)
        if self.up is not None:
            _check_direction("up", self.up)
        if self.epoch_ns is not None and not -(1 << 63) <= self.epoch_ns < 1 << 63:
            raise ValueError(f"epoch_ns {self.epoch_ns} does not fit 64 bits")
        for name in ("title", "licence"):
            text = getattr(self, name)
            if text is not None and not (0 < len(text.encode()) <= MAX_TEXT_BYTES and _is_line(text)):
                raise ValueError(f"{name} must be one line of 1 to {MAX_TEXT_BYTES} bytes")

    @property
    def is_empty(self) -> bool:
        """Whether nothing is known."""
        return all(getattr(self, field.name) is None for field in fields(self))


NOTHING_KNOWN = Metadata()


def _check_numbers(name: str, values: tuple[float, ...]) -> None:
    if not all(abs(value) <= _MAX_NUMBER for value in values):  # NaN fails too
        raise ValueError(f"{name} {values} must be numbers of at most {_MAX_NUMBER:g}")


def _is_line(text: str) -> bool:
    """Whether no character of `text` controls or ends a line (Unicode categories Cc, Zl, Zp)."""
    return not any(unicodedata.category(c) in ("Cc", "Zl", "Zp") for c in text)


def _check_length(name: str, value: float) -> None:
    if not _MIN_LENGTH <= value <= _MAX_NUMBER:
        raise ValueError(f"{name} {value} must be {_MIN_LENGTH:g} to {_MAX_NUMBER:g}")


def _check_direction(name: str, values: tuple[float, ...]) -> None:
    _check_numbers(name, values)
    _check_length(f"length of {name}", math.hypot(*values))
