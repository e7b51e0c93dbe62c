"""One split of a recording: pictures to train on, pictures to test on, and first points for all systems alike."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from streamlod.core.data import Dataset, Split, linspace_split, open_dataset, prefetch, read_split
from streamlod.core.errors import InputError
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.initialise import first_points


@dataclass(frozen=True, slots=True, eq=False)
class Footage:
    """A recording under one split.

    Attributes:
        split: names of the cameras.
        training, testing: the same frames of the training and of the held-out cameras, in the space of training.
        frames: how many to use.
        points: first points, the same for all systems.
    """

    split: Split
    training: Dataset
    testing: Dataset
    frames: int
    points: PointCloud

    def pairs(self) -> Iterator[tuple[FrameSet, FrameSet]]:
        """(training, held-out) pictures of each instant, in order."""
        training, testing = (part.frames(0, self.frames) for part in (self.training, self.testing))
        yield from zip(prefetch(training), prefetch(testing), strict=True)


def chosen_split(data: Path, split: Path | None, views: int | None, test: tuple[str, ...], downscale: float) -> Split:
    """The split of file `split`, or else `views` cameras by the linspace rule with `test` held out.

    Args:
        test: the first camera of the rig where none is named.

    Raises:
        InputError: unusable data, a split file that does not fit it, or one that holds out no camera.
    """
    names = open_dataset(data, downscale=downscale).names
    if split is None:
        return linspace_split(names, views, test or names[:1])
    found = read_split(split, names)
    if not found.test:
        raise InputError(split, "'test' must name at least one held-out camera")
    return found


def footage_frames(data: Path, frames: int | None) -> int:
    """How many frames of a recording are used; `frames` is the most, None for all."""
    count = open_dataset(data).frame_count
    return count if frames is None else min(frames, count)


def pictures_digest(data: Path) -> str:
    """A digest of a recording's cameras, rate, length and first pictures: what tells it from others of its name."""
    recording = open_dataset(data).recording
    source, digest = recording.source, hashlib.blake2b(digest_size=8)
    digest.update(f"{source.fps:.6f} {source.frame_count}".encode())
    for row, camera in enumerate(recording.cameras):
        digest.update(f"{camera.name} {camera.width}x{camera.height}".encode())
        with closing(source.pictures(row, 0, 1)) as pictures:
            arrays = (camera.intrinsics, camera.distortion, camera.world_to_camera, next(pictures))
        for array in arrays:
            digest.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def open_footage(
    data: Path, split: Split, *, frames: int | None, downscale: float, test_downscale: float | None = None
) -> Footage:
    """Open a recording and find its first points from the training pictures alone.

    Args:
        frames: at most so many, or None for all.
        downscale: of the training pictures; test_downscale: of the held-out ones, the same by default.

    Raises:
        InputError: no held-out camera, or a recording that cannot be used.
    """
    if not split.test:
        raise InputError("--test", "needs at least one held-out camera to measure with")
    whole = open_dataset(data, downscale=downscale)
    testing = open_dataset(data, downscale=test_downscale or downscale, cameras=split.test)
    return footage_of(whole, split, frames=frames, testing=testing)


def footage_of(
    whole: Dataset, split: Split, *, frames: int | None, testing: Dataset | None = None, points: str = "auto"
) -> Footage:
    """The footage of a data set that is open already; otherwise like `open_footage`.

    Args:
        testing: the held-out cameras at another size. points: the way to first points.
    """
    whole = whole.normalised()
    training, testing = whole.select(split.train), testing.normalised() if testing else whole.select(split.test)
    count = whole.frame_count if frames is None else min(frames, whole.frame_count)
    first = next(iter(training.frames(0, 1)))
    found = first_points(
        first,
        training.cameras,
        depth_bounds=training.depth_bounds,
        method=points,
        dataset_points=training.points(),
        space=training.space,
    )
    return Footage(split, training, testing, count, found)
