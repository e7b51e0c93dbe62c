"""Findings in the pictures of a running rig: damage, cameras that were knocked, poses that do not hold."""

from __future__ import annotations

import logging
import re
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace

from streamlod.core.arrays import Bool

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Found:
    """Findings about one camera.

    Attributes:
        refused: why its newest picture could not be used; empty when it could.
        shift: how far its picture has moved, in pixels at a width of 1000; None where not known.
        knocked: whether it was.
    """

    refused: str = ""
    shift: float | None = None
    knocked: bool = False


class Findings:
    """The findings about the cameras `names`, noted and read from any thread. What is new is logged once.

    Attributes:
        poses: a sentence about each fault of the cameras' poses, see `poses`.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._lock = threading.Lock()
        self._found = {name: Found() for name in self._names}
        self.poses: tuple[str, ...] = ()

    def of(self, camera: str) -> Found:
        """The findings about one camera."""
        return self._found[camera]

    def note_decoded(self, camera: str, fault: str = "") -> None:
        """A picture of a camera was decoded for training, or could not be, for the reason `fault`."""
        with self._lock:
            found = self._found[camera]
            if fault and not found.refused:
                _LOG.warning("camera %s: %s", camera, fault)
            self._found[camera] = replace(found, refused=fault)

    def note_shifts(self, shifts: Sequence[float | None], knocked: Bool) -> None:
        """How far each camera's picture has moved since it is read, and which were knocked, see `knocks`."""
        with self._lock:
            for name, pixels, is_knocked in zip(self._names, shifts, knocked, strict=True):
                found = self._found[name]
                if is_knocked and not found.knocked:
                    _LOG.warning("camera %s was knocked: its picture has moved by %.0f of 1000 pixels", name, pixels)
                self._found[name] = replace(found, shift=pixels, knocked=bool(is_knocked))

    def note_poses(self, faults: tuple[str, ...]) -> None:
        """Faults of the cameras' poses, in sentences."""
        with self._lock:
            for fault in set(faults) - set(self.poses):
                _LOG.warning("%s", fault)
            self.poses = faults

    def complaint(self, camera: str) -> str:
        """A sentence for who films, where the camera's place or name is wrong; else empty."""
        if self._found[camera].knocked:
            return "it was knocked: put it back as it stood, or calibrate again"
        named = {
            fault: {name for name in self._names if re.search(rf"\b{re.escape(name)}\b", fault)} for fault in self.poses
        }
        return next((fault for fault, names in named.items() if not names or camera in names), "")
