"""Pictures of a board walk: videos in a folder, or any recording that `open_dataset` reads.

With `timestamps.csv` of caliscope beside the videos, its times are the pictures'; otherwise the files' own.
"""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from streamlod.core.arrays import Float64, UInt8
from streamlod.core.data import caliscope, open_dataset
from streamlod.core.data.files import read_text
from streamlod.core.data.names import files_in
from streamlod.core.data.sources import shown
from streamlod.core.data.video import SUFFIXES, VideoInfo, probe_video, read_video
from streamlod.core.errors import InputError
from streamlod.core.options import MAX_CAMERAS


@dataclass(frozen=True, slots=True, eq=False)
class WalkFootage:
    """The pictures of one camera.

    Attributes:
        camera: name.
        size: (width, height) in pixels, upright.
        times: [K] seconds by the camera's own clock, or the table's.
        pictures: opens them: K pictures [H,W,3] RGB in order, None where one is missing.
        file: the video, or none.
        sound: the file whose sound has the same clock, if it has any, or none.
    """

    camera: str
    size: tuple[int, int]
    times: Float64
    pictures: Callable[[], Iterator[UInt8 | None]]
    file: Path | None = None
    sound: Path | None = None

    @property
    def period(self) -> float:
        """Median seconds between pictures; 1 of a single one."""
        return float(np.median(np.diff(self.times))) if len(self.times) > 1 else 1.0


def open_walk(path: Path) -> tuple[WalkFootage, ...]:
    """The cameras of a walk, in numeric order of their names.

    Raises:
        InputError: no such folder, damaged files, or fewer than two cameras.
    """
    if not path.is_dir():
        raise InputError(path, "is not a folder" if path.exists() else "does not exist")
    files = files_in(path, SUFFIXES)
    cameras = tuple(_videos(path, files)) if files else tuple(_recording(path))
    if not 2 <= len(cameras) <= MAX_CAMERAS:
        count = "one camera" if len(cameras) == 1 else f"{len(cameras) or 'no'} cameras"
        raise InputError(path, f"holds {count}; a rig has 2 to {MAX_CAMERAS}, one video each")
    return cameras


def _videos(path: Path, files: list[Path]) -> Iterator[WalkFootage]:
    stems = [file.stem for file in files]
    double = sorted({stem for stem in stems if stems.count(stem) > 1})
    if double:
        raise InputError(path, f"holds several videos called {double[0]}; leave one for each camera")
    table = path / caliscope.TIMES
    stated = _stated_times(table) if table.is_file() else None
    for file in files:
        info = probe_video(file)
        times = np.array(info.times_ns, np.float64) / 1e9
        if stated is not None:
            known = stated.get(file.stem.removeprefix("cam_"))
            if known is None or len(known) != len(times):
                count = 0 if known is None else len(known)
                raise InputError(table, f"has {count} times of {file.name}, which holds {len(times)} pictures")
            times = known
        sound = None if stated is not None or info.one_clock else file
        yield WalkFootage(file.stem, (info.width, info.height), times, partial(_decoded, file, info), file, sound)


def _decoded(file: Path, info: VideoInfo) -> Iterator[UInt8 | None]:
    with closing(read_video(file)) as timed:
        yield from shown(file, timed, info.times_ns)


def _stated_times(table: Path) -> dict[str, Float64]:
    rows: dict[str, list[tuple[int, float]]] = defaultdict(list)
    try:
        for row in csv.DictReader(read_text(table).splitlines()):
            rows[row["cam_id"]].append((int(row["sync_index"]), float(row["frame_time"])))
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise InputError(table, "needs the columns sync_index, cam_id and frame_time, with numbers in them") from error
    times = {camera: np.array([time for _, time in sorted(known)]) for camera, known in rows.items()}
    for camera, known in times.items():
        if not np.isfinite(known).all() or (np.diff(known) <= 0).any():
            raise InputError(table, f"times of camera {camera:.40} do not increase with sync_index")
    return times


def _recording(path: Path) -> Iterator[WalkFootage]:
    recording = open_dataset(path).recording
    source = recording.source
    times = np.array([source.time_ns(index) for index in range(source.frame_count)], np.float64) / 1e9
    for row, camera in enumerate(recording.cameras):
        pictures = partial(source.pictures, row, 0, source.frame_count)
        yield WalkFootage(camera.name, (camera.width, camera.height), times, pictures)
