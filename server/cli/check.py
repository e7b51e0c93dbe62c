"""The command `streamlod check`; returns the text to print and whether anything is at fault."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from streamlod.core.errors import InputError

if TYPE_CHECKING:
    from streamlod.core.calibration.checks.clocks import Clock
    from streamlod.core.calibration.checks.report import RigCheck
    from streamlod.core.frames import FrameSet
    from streamlod.server.ingest.statistics import Statistics
    from streamlod.server.settings import Settings

Say = Callable[[str], None]

_INSTANTS = 6
_LIVE_SECONDS = 20.0  # to wait for a live rig at most
_PHONE_SECONDS = 600.0  # with phones, which somebody has to start
_LIVE_STEP = 10  # instants between those used


def check(source: Path, layout: str | None, settings: Settings, say: Say) -> tuple[str, bool]:
    """Check a recording, or the live rig of a .json file that does not begin with `transforms`.

    Args:
        settings: of the server to which phones of a live rig send their pictures.
        say: told the addresses of their pages.
    """
    live = source.suffix.lower() == ".json" and not source.name.startswith("transforms")
    found = _live(source, settings, say) if live else _recorded(source, layout)
    return found.text(), found.at_fault


def _recorded(data: Path, layout: str | None) -> RigCheck:
    from streamlod.core.calibration.checks import heard
    from streamlod.core.calibration.checks.finding import weak
    from streamlod.core.calibration.checks.report import examine
    from streamlod.core.data import open_dataset
    from streamlod.server.pipeline.sound import loudness_rises, sound_faults

    opened = open_dataset(data, layout=layout)
    count = opened.frame_count
    # pairs of instants one after the other, so that what moves is seen
    begins = sorted({round(part * max(0, count - 2)) for part in (0.1, 0.3, 0.5, 0.7, 0.9)})
    frames: list[FrameSet] = []
    for begin in begins:
        with closing(opened.frames(begin, min(count, begin + 2))) as found:  # type: ignore[type-var]
            frames += found
    examined = examine(opened.undistortions, frames, _clocks(data))
    more = [weak(each) for each in sound_faults(opened)]
    more += heard.judged(loudness_rises(opened), opened.recording.source.fps)
    return replace(examined, findings=(*examined.findings, *more))


def _clocks(data: Path) -> dict[str, Clock]:
    from streamlod.core.calibration.checks.clocks import clock_of
    from streamlod.core.calibration.walk import open_walk

    with suppress(InputError):  # no folder of videos: pictures have no times
        walk = open_walk(data.parent if data.is_file() else data)
        return {each.camera: clock_of(each) for each in walk if each.file is not None and len(each.times) > 1}
    return {}


def _live(file: Path, settings: Settings, say: Say) -> RigCheck:
    """Examine some instants with all cameras, or, where some give nothing in time, those with the others."""
    from streamlod.core.calibration.checks.finding import fact, weak
    from streamlod.core.calibration.checks.report import examine
    from streamlod.core.render.backends import cuda_fault
    from streamlod.server.cli.capture_times import judged_times
    from streamlod.server.cli.pace import judged_pace
    from streamlod.server.cli.rig import phones_socket
    from streamlod.server.cli.room import judged_room
    from streamlod.server.doctor.host import usable_cores
    from streamlod.server.ingest.clap import Clap
    from streamlod.server.ingest.live import open_live

    heard = threading.Event()
    rig = open_live(file, give_sound=lambda _: heard.set())
    clap = Clap(rig.definition, say)
    with ExitStack() as stack:
        socket = phones_socket(file, rig.definition, settings, stack, say)
        rig = replace(rig, definition=replace(rig.definition, quorum=1), push_socket=socket, listeners=clap.listeners)
        seconds = _LIVE_SECONDS if socket is None else _PHONE_SECONDS
        timer = threading.Timer(seconds, rig.close)
        timer.daemon = True
        timer.start()
        stack.callback(timer.cancel)
        frames: list[FrameSet] = []
        partial: deque[FrameSet] = deque(maxlen=_INSTANTS)
        told: Statistics | None = None
        with closing(rig.frames()) as instants:
            for frame in instants:
                told = rig.statistics()
                if frame.index % _LIVE_STEP < 2 and len(frames) < _INSTANTS:
                    (frames if frame.present.all() else partial).append(frame)
                is_wrong = told is not None and any(one.time_fault is not None for one in told.cameras.values())
                enough = len(frames) == _INSTANTS or (is_wrong and len(partial) == _INSTANTS)  # it never has all
                settled = told is None or told.sound != "" or heard.is_set()  # whether there is sound is known
                if enough and settled and clap.is_over():
                    break
    if not frames and not partial:
        raise InputError(file, f"gave no instant within {seconds:.0f} s; see that its cameras run")
    found = examine(rig.undistortions, frames or list(partial))
    more = [] if told is None else judged_times(told, rig.fps)
    if cuda_fault() is not None:
        more += judged_pace([plan.camera for plan in rig.undistortions], usable_cores())
    if told is not None and told.sound is not None:
        name = rig.definition.sound_name
        silent = told.sound or ("" if heard.is_set() else f"no sound of {name}: it sent none within {seconds:.0f} s")
        more.append(weak(silent) if silent else fact(f"the sound of {name} is heard"))
    return replace(found, findings=(*found.findings, *more, *clap.judged(), *judged_room(settings)))
