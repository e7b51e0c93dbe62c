"""The sound of a rig in operation: who takes what its cameras, its microphone or its file give."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import av

from streamlod.codec.mp4.sound import SoundPiece
from streamlod.server.ingest.cameras.definition import RigDefinition
from streamlod.server.ingest.sound.hearing import Hearing
from streamlod.server.ingest.sound.listening import CameraEar, Ear, Ears
from streamlod.server.ingest.sync.timeline import Timeline


class RigSound:
    """Leads sound from a rig's sources to those who want it.

    Args:
        definition: of the rig.
        names: of the cameras that are read.
        timeline: the rig's.
        give: takes the pieces of the definition's sound; None where nobody listens.
        listeners: take what cameras hear that do not push, by name; of those that do, what the definition's sound is.
        wait: see `Hearing`.

    Attributes:
        hearing: takes the definition's sound; None where nobody listens, or there is none.
        ears: take what cameras hear, by name; others' sound is not wanted.
    """

    def __init__(
        self,
        definition: RigDefinition,
        names: Collection[str],
        timeline: Timeline,
        give: Callable[[SoundPiece], None] | None,
        listeners: Mapping[str, CameraEar],
        wait: Callable[[int], None],
    ) -> None:
        self.hearing: Hearing | None = None
        self._camera: str | None = None  # whose connection brings the definition's sound
        if (sound := definition.sound) is not None and give is not None:
            self._camera = sound.camera
            offset_ns = definition.offsets_ns.get(sound.camera or "", 0)
            self.hearing = Hearing(sound.name, give, timeline, wait, offset_ns)
            if sound.camera is not None and sound.camera not in names:
                self.hearing.gone("its camera is not used")
        self.ears = {name: ear for name in names if (ear := self._ear(name, listeners.get(name))) is not None}

    def hears(self, camera: str) -> bool:
        """Whether the definition's sound is the camera's, and wanted."""
        return camera == self._camera

    def put(self, frame: av.AudioFrame, capture_ns: int) -> None:
        """Take the definition's sound where it is pushed, recorded from `capture_ns` on."""
        if self._camera in self.ears:
            self.ears[self._camera].put(frame, capture_ns)

    def fault(self) -> str | None:
        """Why nothing is heard, in a sentence; empty where there is sound; None where none is wanted."""
        return None if self.hearing is None else self.hearing.fault()

    def _ear(self, camera: str, listener: CameraEar | None) -> Ear | None:
        hearing = self.hearing if self.hears(camera) else None
        if listener is None or hearing is None:
            return listener or hearing
        return Ears((listener, hearing))
