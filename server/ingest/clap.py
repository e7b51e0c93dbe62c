"""The word of `check` on what a live rig's cameras hear at one time."""

from __future__ import annotations

import time
from collections.abc import Callable

from streamlod.core.calibration.checks.finding import RigFinding, fact
from streamlod.core.calibration.checks.heard import judged
from streamlod.core.data.names import spoken
from streamlod.server.ingest.cameras.definition import RigDefinition
from streamlod.server.ingest.sound.listening import CameraEar, loudness_rises

_SECONDS = 10.0
_REACH = 4.0  # seconds that cameras' times may be apart


class Clap:
    """Asks for a clap where several cameras of a rig are heard, and compares when each has heard it.

    Args:
        definition: of the rig.
        say: told to clap.

    Attributes:
        listeners: of all cameras, by name, which are to be given their sound.
    """

    def __init__(self, definition: RigDefinition, say: Callable[[str], None]) -> None:
        self._definition, self._say = definition, say
        self._until: float | None = None
        names = [camera.name for camera in definition.cameras]
        self.listeners = {name: CameraEar(name, definition.offsets_ns.get(name, 0)) for name in names}

    def is_over(self) -> bool:
        """Whether it was waited long enough, which begins with the first call; at once where less than two hear."""
        hearing = [name for name, each in self.listeners.items() if each.begin is not None]
        if len(hearing) < 2:
            return True
        if self._until is None:
            self._say(f"clap once, loudly, where {spoken(hearing)} hear it: within {_SECONDS:.0f} s")
            self._until = time.monotonic() + _SECONDS
        return time.monotonic() >= self._until

    def judged(self) -> list[RigFinding]:
        """Cameras that heard at another time than most, and what to write into the rig's file; none without sound."""
        rising = loudness_rises(self.listeners)
        found = list(judged(rising, self._definition.fps, self._remedy, _REACH))
        if not found and len(rising) > 1:
            return [fact(f"of {spoken(rising)} no two heard the same, such as a clap, by which to compare their times")]
        return found

    def _remedy(self, seconds: float) -> str:
        return (
            f"add {-1000 * seconds:.0f} to its offset_ms in {self._definition.path.name}, which is 0 where it is not "
            "written, and check again"
        )
