"""The command `streamlod check`; returns the text to print and whether anything is at fault."""

from __future__ import annotations

import threading
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from streamlod.core.errors import InputError

if TYPE_CHECKING:
    from streamlod.core.calibration.checks.clocks import Clock
    from streamlod.core.calibration.checks.report import RigCheck
    from streamlod.core.frames import FrameSet

_INSTANTS = 6
_LIVE_SECONDS = 20.0  # to wait for a live rig at most
_LIVE_STEP = 10  # instants between those used


def check(source: Path, layout: str | None) -> tuple[str, bool]:
    """Check a recording, or the live rig of a .json file that is no transforms.json."""
    live = source.suffix.lower() == ".json" and source.name != "transforms.json"
    found = _live(source) if live else _recorded(source, layout)
    return found.text(), found.at_fault


def _recorded(data: Path, layout: str | None) -> RigCheck:
    from streamlod.core.calibration.checks.report import examine
    from streamlod.core.data import open_dataset

    opened = open_dataset(data, layout=layout)
    count = opened.frame_count
    # pairs of instants one after the other, so that what moves is seen
    begins = sorted({round(part * max(0, count - 2)) for part in (0.1, 0.5, 0.9)})
    frames: list[FrameSet] = []
    for begin in begins:
        with closing(opened.frames(begin, min(count, begin + 2))) as found:  # type: ignore[type-var]
            frames += found
    return examine(opened.cameras, frames, _clocks(data))


def _clocks(data: Path) -> dict[str, Clock]:
    from streamlod.core.calibration.checks.clocks import clock_of
    from streamlod.core.calibration.walk import open_walk

    with suppress(InputError):  # no folder of videos: pictures have no times
        walk = open_walk(data.parent if data.is_file() else data)
        return {each.camera: clock_of(each) for each in walk if each.file is not None and len(each.times) > 1}
    return {}


def _live(file: Path) -> RigCheck:
    from streamlod.core.calibration.checks.report import examine
    from streamlod.server.ingest.live import open_live

    rig = open_live(file)
    timer = threading.Timer(_LIVE_SECONDS, rig.close)
    timer.daemon = True
    timer.start()
    frames: list[FrameSet] = []
    try:
        for frame in rig.frames():
            if frame.index % _LIVE_STEP < 2:
                frames.append(frame)
            if len(frames) == _INSTANTS:
                break
    finally:
        timer.cancel()
    if not frames:
        raise InputError(file, f"gave no instant within {_LIVE_SECONDS:.0f} s; see that its cameras run")
    return examine(rig.cameras, frames)
