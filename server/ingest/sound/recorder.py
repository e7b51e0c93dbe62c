"""Recording of a rig's sound into a file beside its cameras' videos, on their clock."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

from streamlod.codec.mp4.sound import SoundPiece
from streamlod.codec.sound.opus import SAMPLE_RATE
from streamlod.codec.sound.packets import PacketWriter
from streamlod.core.errors import InputError

_SECOND_NS = 1_000_000_000


class SoundRecorder:
    """Writes sound of a stretch of time; what has been written can be read at any time.

    Args:
        path: of the file, which is made when the first sound comes.
        begin_ns: capture time at which the videos begin; seconds: that they last at most.
        camera: at which the microphone stands, if at one.

    Attributes:
        seconds: of sound that were written.
    """

    def __init__(self, path: Path, begin_ns: int, seconds: float, camera: str | None) -> None:
        self._path, self._camera = path, camera
        self._begin, self._samples = round(begin_ns * SAMPLE_RATE / _SECOND_NS), round(seconds * SAMPLE_RATE)
        self._lock = threading.Lock()
        self._writer: PacketWriter | None = None
        self._failure: InputError | None = None
        self.seconds = 0.0

    def take(self, piece: SoundPiece) -> None:
        """Write what of a piece is of that time, unless the file cannot be written any more."""
        with self._lock:
            packets = [replace(packet, time=packet.time - self._begin) for packet in piece.packets]
            packets = [packet for packet in packets if 0 <= packet.time < self._samples]
            if not packets or self._failure is not None:
                return
            try:
                if self._writer is None:
                    self._writer = PacketWriter(self._path, piece.settings, packets[0].time, self._camera)
                for packet in packets:
                    self._writer.append(packet)
                    self.seconds += packet.samples / SAMPLE_RATE
            except OSError as error:
                self._failure = InputError(self._path, f"cannot be written ({error.strerror or error})")

    def end(self) -> InputError | None:
        """Finish the file; the fault where something could not be written."""
        with self._lock:
            writer, self._writer = self._writer, None
            try:
                if writer is not None:
                    writer.close()
            except OSError as error:
                self._failure = self._failure or InputError(self._path, f"cannot be written ({error})")
            return self._failure
