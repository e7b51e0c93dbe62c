"""Where raw pictures come from: one video a camera, or picture files an instant."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path

from streamlod.core.arrays import UInt8
from streamlod.core.data.dataset import FPS_OF_PICTURES
from streamlod.core.data.pictures import read_picture
from streamlod.core.data.video import VideoInfo, probe_video, read_video
from streamlod.core.errors import InputError

_FPS_TOLERANCE = 0.01


@dataclass(frozen=True, slots=True)
class Videos:
    """Videos that are synchronised picture by picture.

    Attributes:
        files: one a camera.
        fps, frame_count: common to all.
    """

    files: tuple[Path, ...]
    fps: float
    frame_count: int

    def time_ns(self, index: int) -> int:
        """Capture time from the clip's start."""
        return round(index * 1e9 / self.fps)

    def pictures(self, camera: int, start: int, stop: int) -> Generator[UInt8 | None, None, None]:
        """As `Source.pictures`; InputError where the file ends early."""
        yield from read_exactly(self.files[camera], start, stop, self.frame_count)


def videos(files: Sequence[Path]) -> tuple[Videos, list[VideoInfo]]:
    """The source of `files`, and what each of them is like.

    Videos that differ in length, even by one picture, are refused: somewhere a picture was lost or added, and from
    there on the cameras would show different instants.

    Raises:
        InputError: a file that is no sound video, or lengths or rates that differ.
    """
    infos = [probe_video(file) for file in files]
    first = infos[0]
    for file, info in zip(files, infos, strict=True):
        if info.frame_count != first.frame_count:
            shorter = min(info.frame_count, first.frame_count)
            raise InputError(
                file,
                f"holds {info.frame_count} pictures, but {files[0].name} {first.frame_count}; if both start at one "
                f"instant, cut them to {shorter} (ffmpeg -frames:v {shorter})",
            )
        if abs(info.fps - first.fps) > _FPS_TOLERANCE * first.fps:
            raise InputError(file, f"runs at {info.fps:g} pictures a second, but {files[0].name} at {first.fps:g}")
    if first.frame_count < 1:
        raise InputError(files[0], "holds no pictures")
    return Videos(tuple(files), first.fps, first.frame_count), infos


def read_exactly(file: Path, start: int, stop: int, expected: int) -> Generator[UInt8, None, None]:
    """Pictures start to stop - 1 of a video that should hold `expected`; InputError if it ends before stop."""
    number = start
    if start >= stop:
        return
    for picture in read_video(file, start):
        yield picture
        number += 1
        if number == stop:
            return
    raise InputError(file, f"ends after {number} of its {expected} pictures; the file is damaged, copy it again")


@dataclass(frozen=True, slots=True)
class Pictures:
    """Picture files.

    Attributes:
        files: for each instant, one a camera; a camera without a file there is missing at that instant.
    """

    files: tuple[tuple[Path, ...], ...]
    fps: float = FPS_OF_PICTURES

    @property
    def frame_count(self) -> int:
        """Number of instants."""
        return len(self.files)

    def time_ns(self, index: int) -> int:
        """Capture time from the clip's start, at a supposed rate."""
        return round(index * 1e9 / self.fps)

    def pictures(self, camera: int, start: int, stop: int) -> Generator[UInt8 | None, None, None]:
        """As `Source.pictures`."""
        for instant in self.files[start:stop]:
            yield read_picture(instant[camera]) if instant[camera].is_file() else None
