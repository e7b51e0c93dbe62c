"""One picture of one camera, on its way from a source to the synchroniser."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from streamlod.core.arrays import UInt8
from streamlod.server.ingest.sync.clock import ClockSource


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A picture and when it was taken.

    Attributes:
        camera: name of the camera.
        capture_ns: capture time, nanoseconds since 1970.
        source: evidence of the time.
        error_ns: how far the time may be off.
        load: decodes the [H,W,3] uint8 RGB pixels; called only for pictures that are used, by any thread; raises
            InputError for one that does not decode.
    """

    camera: str
    capture_ns: int
    source: ClockSource
    error_ns: int
    load: Callable[[], UInt8]


def one_at_a_time(load: Callable[[], UInt8]) -> Callable[[], UInt8]:
    """`load` of a frame of FFmpeg for any thread: a frame holds its conversion, which hangs or crashes if two enter it.

    A recording, the walk's watch and training may all want one picture at once.
    """
    alone = threading.Lock()

    def guarded() -> UInt8:
        with alone:
            return load()

    return guarded
