"""Videos whose pictures are paired by a table of their times, as caliscope writes it."""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from streamlod.core.arrays import Float64, Int64, UInt8, nearest_of
from streamlod.core.data.dataset import Film
from streamlod.core.data.files import read_text
from streamlod.core.data.sources import shown
from streamlod.core.data.video import VideoInfo, read_video
from streamlod.core.errors import InputError

_NEAR = 0.75  # intervals between instants, within which a picture is of one


@dataclass(frozen=True, slots=True)
class TimedVideos:
    """Videos whose pictures are paired by a table.

    Attributes:
        files: one a camera.
        times_ns: mean capture time of each instant, from the first one's.
        taken_ns: for each camera, its picture's time in its file at each instant; None where it has none.
        fps: instants a second, from the median interval.
    """

    files: tuple[Path, ...]
    times_ns: tuple[int, ...]
    taken_ns: tuple[tuple[int | None, ...], ...]
    fps: float

    @property
    def frame_count(self) -> int:
        """Number of instants."""
        return len(self.times_ns)

    def time_ns(self, index: int) -> int:
        """Capture time from the clip's start."""
        return self.times_ns[index]

    def pictures(self, camera: int, start: int, stop: int) -> Generator[UInt8 | None, None, None]:
        """Yield pictures; see `Source.pictures`."""
        taken = self.taken_ns[camera][start:stop]
        with closing(read_video(self.files[camera])) as pictures:
            found = shown(self.files[camera], pictures, [time_ns for time_ns in taken if time_ns is not None])
            for time_ns in taken:
                yield None if time_ns is None else next(found)

    def film(self, camera: int) -> Film | None:
        """The camera's file; see `Source.film`."""
        pairs = zip(self.taken_ns[camera], self.times_ns, strict=True)
        begin = next((taken_ns - time_ns for taken_ns, time_ns in pairs if taken_ns is not None), None)
        return None if begin is None else Film(self.files[camera], begin)


def paired(
    path: Path, keys: Sequence[str], files: Sequence[Path], infos: Sequence[VideoInfo], offsets: Float64
) -> TimedVideos:
    """The videos `files` of cameras `keys`, paired by the table at `path`.

    Args:
        offsets: [C] seconds that are added to each camera's times. Where there are any, its pictures go to the instants
            that they are nearest to then, which may be others than the table's, and instants count that all could film.

    Raises:
        InputError: the table is damaged, or of other videos.
    """
    stated = _stated(path, keys)
    for has, file, info in zip(np.isfinite(stated).T, files, infos, strict=True):
        if has.sum() != info.frame_count:
            raise InputError(path, f"has {has.sum()} times of {file.name}, which holds {info.frame_count} pictures")
    seconds = np.nanmean(stated, axis=1)
    interval = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 1 / infos[0].fps
    if interval <= 0:
        raise InputError(path, "its times do not increase with sync_index")
    rows = np.where(np.isfinite(stated), np.cumsum(np.isfinite(stated), axis=0) - 1, -1)
    if offsets.any():
        if any((np.diff(column[np.isfinite(column)]) <= 0).any() for column in stated.T):
            raise InputError(path, "its times do not increase with sync_index")
        seconds, rows = _moved(stated + offsets, interval)
        if not len(seconds):
            raise InputError(path, "has no instant that all cameras filmed, by their time_offset")
    taken = [
        tuple(info.times_ns[row] if row >= 0 else None for row in column)
        for info, column in zip(infos, rows.T.tolist(), strict=True)
    ]
    return TimedVideos(tuple(files), tuple(round(s * 1e9) for s in seconds - seconds[0]), tuple(taken), 1 / interval)


def _stated(path: Path, keys: Sequence[str]) -> Float64:
    """[T,C] seconds of each instant's picture by each camera; NaN where it has none."""
    times: dict[int, dict[str, float]] = defaultdict(dict)
    try:
        for row in csv.DictReader(read_text(path).splitlines()):
            if row["cam_id"] in keys:
                times[int(row["sync_index"])][row["cam_id"]] = float(row["frame_time"])
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise InputError(path, "needs the columns sync_index, cam_id and frame_time, with numbers in them") from error
    instants = [times[index] for index in sorted(times)]
    if not instants or not np.isfinite([t for instant in instants for t in instant.values()]).all():
        raise InputError(path, "holds no usable time of any camera")
    return np.array([[instant.get(key, np.nan) for key in keys] for instant in instants])


def _moved(times: Float64, interval: float) -> tuple[Float64, Int64]:
    """[T] seconds of instants, and [T,C] which picture each camera has of them, -1 for none, by times [T,C]."""
    instants = np.sort(np.nanmedian(times, axis=1))
    rows = np.full(times.shape, -1)
    for camera, column in enumerate(times.T):
        taken = column[np.isfinite(column)]
        nearest = nearest_of(taken, instants)
        mutual = nearest_of(instants, taken)[nearest] == np.arange(len(instants))
        good = mutual & (np.abs(taken[nearest] - instants) < _NEAR * interval)
        rows[good, camera] = nearest[good]
    reached = np.flatnonzero((rows >= 0).all(axis=1))
    common = slice(reached[0], reached[-1] + 1) if len(reached) else slice(0)
    return instants[common], rows[common]
