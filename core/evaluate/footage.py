"""One split of a recording: pictures to train on, pictures to test on, and first points for all systems alike."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from core.camera import Camera
from core.data import Dataset, Split, open_dataset, prefetch
from core.errors import InputError
from core.frames import FrameSet, PointCloud
from core.initialise import first_points


@dataclass(frozen=True, slots=True, eq=False)
class Footage:
    """A recording under one split.

    Attributes:
        split: names of the cameras.
        training, testing: the same frames of the training and of the held-out cameras.
        rig: all cameras, at the size of the training pictures.
        frames: how many to use.
        points: first points, the same for all systems.
    """

    split: Split
    training: Dataset
    testing: Dataset
    rig: tuple[Camera, ...]
    frames: int
    points: PointCloud

    def pairs(self) -> Iterator[tuple[FrameSet, FrameSet]]:
        """(training, held-out) pictures of each instant, in order."""
        training, testing = (part.frames(0, self.frames) for part in (self.training, self.testing))
        yield from zip(prefetch(training), prefetch(testing), strict=True)


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
    training = whole.select(split.train)
    count = whole.frame_count if frames is None else min(frames, whole.frame_count)
    first = next(iter(training.frames(0, 1)))
    points = first_points(
        first, training.cameras, depth_bounds=training.depth_bounds, dataset_points=training.points(), seed=0
    )
    return Footage(split, training, testing, whole.cameras, count, points)
