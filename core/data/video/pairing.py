"""Pairs the pictures of a rig's video files by their times, by the rules that hold for live cameras.

Instants lie on a grid with the rig's period. A picture belongs to the instant nearest to it, and of two pictures of a
camera the nearer one is used. A camera without a picture at an instant is missing there.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median_low
from typing import TypeVar

from streamlod.core.camera.grid import Grid, best_phase, is_steady, period_of, phase_of
from streamlod.core.data.names import listed
from streamlod.core.data.video.file import VideoInfo
from streamlod.core.errors import InputError

T = TypeVar("T")
_log = logging.getLogger(__name__)
_RATE_TOLERANCE = 0.01
_SETTLED = 0.8  # length of a camera's mean phase vector from which its pictures lie at one phase
_MAX_COUNTED = 2000  # pictures from which a camera's phase is found


def paired(files: Sequence[Path], infos: Sequence[VideoInfo]) -> tuple[Grid, tuple[int, ...]]:
    """The grid of a rig's files, and the numbers, ascending, of the instants that more than half of them hold.

    What is missing is logged, as the files alone do not show it.

    Raises:
        InputError: steady rates that do not belong together, or files that have no time in common.
    """
    fps = median_low(info.fps for info in infos)
    _check_rates(files, infos, fps)
    grid = Grid(period_of(fps), 0, infos[0].times_ns[0])
    phases = [phase for info in infos if (phase := _phase(info, grid)) is not None]
    grid = Grid(grid.period_ns, 0, grid.anchor_ns + round(best_phase(phases) * grid.period_ns))
    held = [{grid.instant_of(time_ns) for time_ns in info.times_ns} for info in infos]
    counts = Counter(number for numbers in held for number in numbers)
    numbers = tuple(sorted(number for number, count in counts.items() if 2 * count > len(infos)))
    if not numbers:
        raise InputError(
            files[0].parent,
            f"its videos ({listed(file.name for file in files)}) were not filmed at one time, as their times say",
        )
    missing = [
        f"{file.name} at {lacking}"
        for file, of_camera in zip(files, held, strict=True)
        if (lacking := sum(number not in of_camera for number in numbers))
    ]
    if missing:
        _log.warning("of %d instants, pictures are missing in: %s", len(numbers), listed(missing))
    if len(numbers) < len(counts):
        fault = "%s: left out are %d of %d instants, which less than half of the cameras filmed"
        _log.warning(fault, files[0].parent, len(counts) - len(numbers), len(counts))
    return grid, numbers


def nearest(pictures: Iterator[tuple[int, T]], grid: Grid) -> Iterator[tuple[int, T]]:
    """(instant, picture) from (time in nanoseconds, picture): of each instant, the picture nearest to it."""
    best: tuple[int, int, T] | None = None  # number, distance, picture
    for time_ns, picture in pictures:
        number = grid.instant_of(time_ns)
        distance = abs(time_ns - grid.time_of(number))
        if best is not None and number != best[0]:
            yield best[0], best[2]
            best = None
        if best is None or distance < best[1]:
            best = number, distance, picture
    if best is not None:
        yield best[0], best[2]


def picked(pictures: Iterator[tuple[int, T]], wanted: Sequence[int]) -> Iterator[T | None]:
    """The pictures of the ascending numbers `wanted`, None for each that is not there."""
    current = next(pictures, None)
    for number in wanted:
        while current is not None and current[0] < number:
            current = next(pictures, None)
        yield current[1] if current is not None and current[0] == number else None


def _check_rates(files: Sequence[Path], infos: Sequence[VideoInfo], fps: float) -> None:
    """Refuse a steady rate that is not near the rig's or a multiple of it: such a file does not show true times."""
    usual = files[[info.fps for info in infos].index(fps)]
    for file, info in zip(files, infos, strict=True):
        ratio = max(info.fps / fps, fps / info.fps)
        tolerance = max(_RATE_TOLERANCE, 0.5 / info.frame_count)  # jitter makes the rate of few pictures uncertain
        if abs(ratio / round(ratio) - 1) > tolerance and is_steady(info.times_ns, info.fps):
            raise InputError(
                file,
                f"runs at {info.fps:g} pictures a second, but {usual.name} at {fps:g}; give it its true rate",
            )


def _phase(info: VideoInfo, grid: Grid) -> float | None:
    """Where between two instants a camera's pictures lie; None where that changes."""
    step = -(-info.frame_count // _MAX_COUNTED)
    turns = [grid.turn_of(time_ns) for time_ns in info.times_ns[::step]]
    mean = sum(turns) / len(turns)
    return phase_of(mean) if abs(mean) > _SETTLED else None
