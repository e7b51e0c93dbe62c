"""Who pushes the cameras of a rig."""

from __future__ import annotations

import threading
from collections.abc import Sequence


class Holders:
    """The capture nodes that push cameras; a later one takes a camera over, as after a reconnection."""

    def __init__(self, cameras: Sequence[str]) -> None:
        self._lock = threading.Lock()
        self._holders: dict[str, object] = {}
        self._claims = dict.fromkeys(cameras, 0)

    def claim(self, camera: str, holder: object) -> None:
        """Make `holder` the one that pushes the camera."""
        with self._lock:
            self._holders[camera] = holder
            self._claims[camera] += 1

    def leave(self, camera: str) -> None:
        """Nobody pushes the camera."""
        with self._lock:
            self._holders.pop(camera, None)

    def holds(self, camera: str, holder: object) -> bool:
        """Whether nobody has claimed the camera after `holder`."""
        return self._holders.get(camera) is holder

    def is_held(self, camera: str) -> bool:
        """Whether somebody pushes the camera."""
        return camera in self._holders

    def claims(self) -> dict[str, int]:
        """How often a capture node began to push each camera."""
        with self._lock:
            return dict(self._claims)
