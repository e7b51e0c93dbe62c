"""Looks through cameras: one picture of each, all at the same time."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import av

from streamlod.core.arrays import UInt8
from streamlod.core.data.video.times import pictures_of
from streamlod.core.data.video.upright import upright
from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.address import Address
from streamlod.server.ingest.cameras.opening import open_source

_LOOK_SECONDS = 15.0  # for all of them
_MAX_PIXELS = 7680 * 4320
_RATES = 1, 240  # pictures a second that are believed
_SKIPPED = 5  # pictures at first, in which a webcam finds its exposure


@dataclass(frozen=True, slots=True, eq=False)
class Glance:
    """A look at a source: its picture [H,W,3] RGB, or why there is none, and its pictures a second where it tells."""

    picture: UInt8 | None
    fault: str = ""
    fps: float | None = None


def look_through(sources: Sequence[Address], fps: float, size: tuple[int, int] | None) -> list[Glance]:
    """A picture of each source, or why there is none after some seconds.

    Args:
        fps, size: asked of webcams; (width, height), or None for their default.
    """
    looks = [_Looking(source, fps, size) for source in sources]
    for each in looks:
        each.start()
    end = time.monotonic() + _LOOK_SECONDS
    for each in looks:
        each.join(max(0.0, end - time.monotonic()))
    return [each.found for each in looks]


class _Looking(threading.Thread):
    """Looks through one camera; one that hangs is left behind, as a daemon."""

    def __init__(self, source: Address, fps: float, size: tuple[int, int] | None) -> None:
        super().__init__(daemon=True, name="look")
        self._source, self._fps, self._size = source, fps, size
        self.found = Glance(None, "gave no picture in time")

    def run(self) -> None:
        try:
            self.found = self._first()
        except InputError as error:
            self.found = Glance(None, error.fault)
        except (av.FFmpegError, OSError, ValueError) as error:
            self.found = Glance(None, getattr(error, "strerror", None) or str(error))

    def _first(self) -> Glance:
        with ExitStack() as stack:
            container = open_source(self._source, self._fps, self._size, stack)
            stream = pictures_of(container)
            if stream is None:
                raise InputError("source", "holds no pictures, only other streams")
            stream.codec_context.options = {"max_pixels": str(_MAX_PIXELS)}
            last: av.VideoFrame | None = None
            for number, frame in enumerate(container.decode(stream)):
                last = frame
                if number >= _SKIPPED:
                    break
            if last is None:
                raise InputError("source", "ended without a picture")
            rate = stream.average_rate or stream.guessed_rate
            return Glance(upright(last), fps=float(rate) if rate and _RATES[0] <= rate <= _RATES[1] else None)
