"""Looks through cameras: one picture of each, all at the same time."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import islice

import av

from streamlod.core.arrays import UInt8
from streamlod.core.data.video.times import pictures_of
from streamlod.core.data.video.upright import upright
from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.address import Address
from streamlod.server.ingest.cameras.opening import open_source
from streamlod.server.ingest.finding.at_once import at_once

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
    found = [Glance(None, "gave no picture in time")] * len(sources)

    def look(number: int) -> None:
        try:
            found[number] = _first(sources[number], fps, size)
        except InputError as error:
            found[number] = Glance(None, error.fault)
        except (av.FFmpegError, OSError, ValueError) as error:
            found[number] = Glance(None, getattr(error, "strerror", None) or str(error))

    at_once([partial(look, number) for number in range(len(sources))], _LOOK_SECONDS)
    return list(found)  # as they are now: a camera that hangs may come back later


def _first(source: Address, fps: float, size: tuple[int, int] | None) -> Glance:
    with ExitStack() as stack:
        container = open_source(source, fps, size, stack)
        stream = pictures_of(container)
        if stream is None:
            raise InputError("source", "holds no pictures, only other streams")
        stream.codec_context.options = {"max_pixels": str(_MAX_PIXELS)}
        last = deque(islice(container.decode(stream), _SKIPPED + 1), maxlen=1)
        if not last:
            raise InputError("source", "ended without a picture")
        rate = stream.average_rate or stream.guessed_rate
        return Glance(upright(last[0]), fps=float(rate) if rate and _RATES[0] <= rate <= _RATES[1] else None)
