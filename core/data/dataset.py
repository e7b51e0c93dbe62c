"""A recording as its files hold it, and the data set that training sees."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from itertools import repeat
from pathlib import Path
from typing import Protocol

import numpy as np

from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera
from streamlod.core.camera.space import UNCHANGED, Similarity, training_space
from streamlod.core.data.lens import Undistortion, undistortions
from streamlod.core.data.names import camera_names
from streamlod.core.data.placed import PlacedCameras, row_of
from streamlod.core.errors import InputError
from streamlod.core.frames import FrameSet, PointCloud

_log = logging.getLogger(__name__)
MAX_DOWNSCALE = 64
FPS_OF_PICTURES = 30.0  # folders of pictures do not say their rate


@dataclass(frozen=True, slots=True)
class Film:
    """A camera's video file.

    Attributes:
        path: the file.
        begin_ns: time in the file at which the clip begins.
    """

    path: Path
    begin_ns: int


class Source(Protocol):
    """Raw pictures of all cameras, by instant."""

    @property
    def fps(self) -> float:
        """Instants a second."""

    @property
    def frame_count(self) -> int:
        """Number of instants."""

    def time_ns(self, index: int) -> int:
        """Capture time of an instant, nanoseconds from the clip's start."""

    def pictures(self, camera: int, start: int, stop: int) -> Generator[UInt8 | None, None, None]:
        """[H,W,3] RGB of one camera for the instants start to stop - 1; None where it has none."""

    def film(self, camera: int) -> Film | None:
        """The file that a camera filmed; None where there are only pictures."""


@dataclass(frozen=True, slots=True, eq=False)
class RawRecording:
    """A recording as the reader of its layout found it.

    Attributes:
        path: folder. layout: name of its layout.
        cameras: as calibrated, distortion included; intrinsics in pixels of the raw pictures. Their names are made fit
            to be sent (`names.camera_names`).
        source: the raw pictures, in the order of `cameras`.
        read_points: reads the points that came with the calibration into a space, or none.
        depth_bounds: nearest and farthest depth of the scene in the calibration's units, if the layout says.
        skipped: names of pictures that the calibration lists and the folder lacks.

    Raises:
        InputError: no camera, or two of one name.
    """

    path: Path
    layout: str
    cameras: tuple[Camera, ...]
    source: Source
    read_points: Callable[[Similarity], PointCloud] | None = None
    depth_bounds: tuple[float, float] | None = None
    skipped: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.cameras:
            raise InputError(self.path, f"holds no camera with pictures in the {self.layout} layout")
        names = camera_names([camera.name for camera in self.cameras])
        named = (replace(camera, name=name) for camera, name in zip(self.cameras, names, strict=True))
        object.__setattr__(self, "cameras", tuple(named))
        known = set()
        for camera in self.cameras:
            if camera.name in known:
                raise InputError(self.path, f"holds two cameras called {camera.name}")
            known.add(camera.name)


@dataclass(frozen=True, slots=True, eq=False)
class Dataset(PlacedCameras):
    """Cameras, and their pictures, read as they are asked for.

    Attributes:
        recording: where the pictures come from.
        rows: number in the recording of each camera used here.
        undistortions, space, cameras: as in `PlacedCameras`.
    """

    recording: RawRecording
    rows: tuple[int, ...]
    undistortions: tuple[Undistortion, ...]
    space: Similarity = UNCHANGED
    cameras: tuple[Camera, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", self.placed_cameras)

    @property
    def calibration(self) -> RawRecording:
        """See `PlacedCameras`."""
        return self.recording

    @property
    def layout(self) -> str:
        """Name of the layout that was read."""
        return self.recording.layout

    @property
    def fps(self) -> float:
        """Instants a second."""
        return self.recording.source.fps

    @property
    def frame_count(self) -> int:
        """Number of instants."""
        return self.recording.source.frame_count

    @property
    def skipped(self) -> tuple[str, ...]:
        """Names of pictures that the calibration lists and the folder lacks."""
        return self.recording.skipped

    def normalised(self) -> Dataset:
        """The same data set in the space of training (`core.camera.space`), where unit and origin are the rig's."""
        return self.placed(training_space(self.recording.cameras, self.recording.depth_bounds))

    def placed(self, space: Similarity) -> Dataset:
        """The same data set in another space, to which `space` leads from the calibration's coordinates."""
        return replace(self, space=space)

    def select(self, names: Sequence[str]) -> Dataset:
        """The same data set with the cameras `names` only, in that order.

        Raises:
            InputError: a name that does not exist, or given twice.
        """
        rows = self.rows_of(names)
        return replace(
            self,
            rows=tuple(self.rows[row] for row in rows),
            undistortions=tuple(self.undistortions[row] for row in rows),
        )

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[FrameSet]:
        """The instants start to stop - 1 (to the last one by default), one in memory at a time.

        Cameras are decoded side by side on a thread each. Dropping the iterator, or its close(), closes the files.

        Raises:
            ValueError: start or stop outside the clip.
            InputError: while iterating, for a file that turns out to be damaged.
        """
        stop = self.frame_count if stop is None else stop
        if not 0 <= start <= stop <= self.frame_count:
            raise ValueError(f"frames {start} to {stop} are not inside the clip's {self.frame_count}")
        return self._frames(start, stop)

    def _frames(self, start: int, stop: int) -> Iterator[FrameSet]:
        source, count = self.recording.source, len(self.cameras)
        height, width = self.cameras[0].height, self.cameras[0].width
        with ExitStack() as stack:
            streams = [source.pictures(row, start, stop) for row in self.rows]
            odd: set[str] = set()
            for stream in streams:
                stack.enter_context(closing(stream))
            pool = stack.enter_context(ThreadPoolExecutor(min(count, os.cpu_count() or 1), "decode"))
            for index in range(start, stop):
                images = np.zeros((count, height, width, 3), np.uint8)
                present = pool.map(_undistort, streams, self.undistortions, images, repeat(index), repeat(odd))
                yield FrameSet(index, source.time_ns(index), images, np.array(list(present), np.bool_))


def dataset(recording: RawRecording, downscale: float = 1, cameras: Sequence[str] | None = None) -> Dataset:
    """The data set of `recording`, scaled down by `downscale`, with the cameras named, or all.

    Raises:
        InputError: `downscale` below 1, a camera that does not exist, pictures of different shapes, or a distortion
            that cannot be undone.
    """
    if not 1 <= downscale <= MAX_DOWNSCALE:
        raise InputError("downscale", f"must lie between 1 and {MAX_DOWNSCALE}, not {downscale}")
    names = [camera.name for camera in recording.cameras]
    rows = range(len(names)) if cameras is None else [row_of(name, names, recording.path) for name in cameras]
    if not rows:
        raise InputError(recording.path, "needs at least one camera selected")
    plans = undistortions([recording.cameras[row] for row in rows], downscale)
    chosen = Dataset(recording, tuple(rows), plans)
    return chosen.select(chosen.names)


def _undistort(stream: Iterator[UInt8 | None], plan: Undistortion, into: UInt8, index: int, odd: set[str]) -> bool:
    """Put the next picture into `into`; False where the camera has none, or one of another size.

    The first one of another size is logged, and the camera's name added to `odd`.
    """
    picture = next(stream)
    if picture is None:
        return False
    width, height, name = plan.lens.width, plan.lens.height, plan.camera.name
    if picture.shape == (height, width, 3):
        into[:] = plan(picture)
        return True
    if name not in odd:
        odd.add(name)
        fault = "camera %s: has %dx%d pixels at instant %d, not %dx%d; its pictures of another size are left out"
        _log.warning(fault, name, picture.shape[1], picture.shape[0], index, width, height)
    return False
