"""Where raw pictures come from: one video a camera, or picture files an instant."""

from __future__ import annotations

import logging
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import av

from streamlod.core.arrays import UInt8
from streamlod.core.camera.grid import Grid
from streamlod.core.data.dataset import FPS_OF_PICTURES, Film
from streamlod.core.data.files import blaming
from streamlod.core.data.pictures import read_picture
from streamlod.core.data.video.file import VideoInfo, probe_video, read_video
from streamlod.core.data.video.pairing import nearest, paired, picked
from streamlod.core.data.video.upright import upright
from streamlod.core.errors import InputError

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Videos:
    """Videos whose pictures are paired by their times.

    Attributes:
        files: one a camera.
        grid: the instants at which the cameras filmed.
        numbers: ascending, of those instants on the grid that enough cameras hold.
        offsets_ns: for each camera, nanoseconds from its file's times to the grid's.
        one_clock: whether the files were written on one clock, so that the offsets are those of the cameras themselves.
    """

    files: tuple[Path, ...]
    grid: Grid
    numbers: tuple[int, ...]
    offsets_ns: tuple[int, ...]
    one_clock: bool = False

    @property
    def fps(self) -> float:
        """Instants a second."""
        return float(1_000_000_000 / self.grid.period_ns)

    @property
    def frame_count(self) -> int:
        """Number of instants."""
        return len(self.numbers)

    def time_ns(self, index: int) -> int:
        """Capture time from the clip's start."""
        return round((self.numbers[index] - self.numbers[0]) * self.grid.period_ns)

    def pictures(self, camera: int, start: int, stop: int) -> Generator[UInt8 | None, None, None]:
        """Yield pictures; see `Source.pictures`."""
        with closing(read_video(self.files[camera])) as pictures:
            timed = ((time_ns + self.offsets_ns[camera], picture) for time_ns, picture in pictures)
            yield from shown(self.files[camera], nearest(timed, self.grid), self.numbers[start:stop])

    def film(self, camera: int) -> Film:
        """The camera's file; see `Source.film`."""
        return Film(self.files[camera], self.grid.time_of(self.numbers[0]) - self.offsets_ns[camera])


def videos(files: Sequence[Path], offsets_ns: Sequence[int] | None = None) -> tuple[Videos, list[VideoInfo]]:
    """The source of `files`, and what each of them is like.

    Args:
        offsets_ns: nanoseconds by which each file began after the others, as a calibration found out; none by default.

    Raises:
        InputError: a file that is no sound video, or files that cannot be paired.
    """
    infos = [probe_video(file) for file in files]
    offsets_ns = [0] * len(files) if offsets_ns is None else offsets_ns
    infos = [
        replace(info, times_ns=tuple(time_ns + offset_ns for time_ns in info.times_ns)) if offset_ns else info
        for info, offset_ns in zip(infos, offsets_ns, strict=True)
    ]
    grid, numbers = paired(files, infos)
    one_clock = all(info.one_clock for info in infos)
    return Videos(tuple(files), grid, numbers, tuple(offsets_ns), one_clock), infos


def shown(
    file: Path, pictures: Iterator[tuple[int, av.VideoFrame]], wanted: Sequence[int]
) -> Generator[UInt8 | None, None, None]:
    """[H,W,3] RGB of the ascending numbers `wanted` in numbered pictures of `file`; None where there is none."""
    for picture in picked(pictures, wanted):
        with blaming(file):
            pixels = None if picture is None else upright(picture)
        yield pixels


@dataclass(frozen=True, slots=True)
class Pictures:
    """Picture files.

    Attributes:
        files: for each instant, one a camera; a camera without a file that can be read is missing at that instant.
        numbers: ascending, how many periods after the first one each instant lies.
    """

    files: tuple[tuple[Path, ...], ...]
    numbers: tuple[int, ...] = (0,)
    fps: float = FPS_OF_PICTURES

    @property
    def frame_count(self) -> int:
        """Number of instants."""
        return len(self.files)

    def time_ns(self, index: int) -> int:
        """Capture time from the clip's start, at a supposed rate."""
        return round(self.numbers[index] * 1e9 / self.fps)

    def pictures(self, camera: int, start: int, stop: int) -> Generator[UInt8 | None, None, None]:
        """Yield pictures; see `Source.pictures`."""
        for instant in self.files[start:stop]:
            yield _readable(instant[camera])

    def film(self, camera: int) -> None:
        """There is none; see `Source.film`."""


def _readable(file: Path) -> UInt8 | None:
    """The picture in `file`; None where there is none, or it is damaged, which is logged."""
    if not file.is_file():
        return None
    try:
        return read_picture(file)
    except InputError as error:
        _log.warning("%s; its camera is missing at that instant", error)
        return None
