"""A job's data set, opened, and the cameras of it that train."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from streamlod.codec.mp4.sound import SoundPiece
from streamlod.core.camera import Camera
from streamlod.core.camera.space import space_of
from streamlod.core.data import Dataset, open_dataset, prefetch, training_cameras
from streamlod.core.errors import InputError
from streamlod.core.frames import FrameSet
from streamlod.core.options import MAX_CAMERAS
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.metadata import Metadata
from streamlod.core.synthetic import open_synthetic
from streamlod.server.ingest.live import LiveDataset, open_live
from streamlod.server.ingest.statistics import Statistics
from streamlod.server.pipeline.checks import synthetic_spec
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.stages.trace import Span, timed

_PREFETCHED = 2  # frames decoded ahead


@dataclass(frozen=True, slots=True, eq=False)
class OpenJob:
    """A job's data set, reduced to the cameras it trains on, and the whole rig.

    Attributes:
        on_read: called with each frame as soon as it is read, on the reading thread.
    """

    job: TrainJob
    dataset: Dataset | LiveDataset
    rig: tuple[Camera, ...]
    on_read: Callable[[FrameSet], None] = lambda _: None

    @property
    def stop(self) -> int | None:
        """Number of the frame before which the job ends; None for live cameras without an end."""
        stop, count = self.job.frames, self.dataset.frame_count
        return stop if count is None else count if stop is None else min(stop, count)

    def frames(self, start: int, announce: Callable[[FrameSet], None]) -> Generator[tuple[FrameSet, Span], None, None]:
        """The job's frames from `start`, with the time that reading took.

        Files are read ahead of training. Live frames are not: one read ahead would be old when training takes it.

        Args:
            announce: called as `on_read`.
        """
        announced = _announced(self.dataset.frames(start, self.stop), self.on_read, announce)
        frames = timed(announced, "read")
        return frames if isinstance(self.dataset, LiveDataset) else prefetch(frames, _PREFETCHED)

    @property
    def facts(self) -> Metadata:
        """Title and licence of the scene, as the job has them."""
        return Metadata(title=self.job.title, licence=self.job.licence)

    def continuing(self, scene: Scene) -> OpenJob:
        """The same job with its cameras where `scene` has them, which may come from another calibration's space."""
        space = space_of(self.rig, scene.header.cameras)
        if space is None:
            return self
        dataset = self.dataset.placed(space.after(self.dataset.space))
        return replace(self, dataset=dataset, rig=tuple(space.camera(camera) for camera in self.rig))

    @property
    def microphone(self) -> str | None:
        """The camera at which the sound of live cameras is heard; None for other microphones, and for none."""
        return self.dataset.definition.microphone if isinstance(self.dataset, LiveDataset) else None

    def statistics(self) -> Statistics | None:
        """Figures of live cameras; None for files, and while nothing is read."""
        return self.dataset.statistics() if isinstance(self.dataset, LiveDataset) else None

    def close(self) -> None:
        """Stop reading live cameras; may be called from any thread."""
        if isinstance(self.dataset, LiveDataset):
            self.dataset.close()


def open_job(
    job: TrainJob, push_socket: Path | None = None, give_sound: Callable[[SoundPiece], None] | None = None
) -> OpenJob:
    """Open the data set and choose the cameras.

    Args:
        push_socket: where a live rig takes pictures that capture nodes push.
        give_sound: takes a live rig's sound as it comes, on threads of its own.

    Raises:
        InputError: the data set or the choice is unusable.
    """
    dataset: Dataset | LiveDataset
    if job.live is not None:
        dataset = open_live(job.live, downscale=job.downscale, push_socket=push_socket, give_sound=give_sound)
    elif job.data is not None:
        dataset = open_dataset(job.data, layout=job.layout, downscale=job.downscale)
    else:
        dataset = open_synthetic(synthetic_spec(job.synthetic or {}))
    names = training_cameras(dataset.names, job.train, job.views, job.test)
    dataset = dataset.normalised()
    chosen = dataset.select(names)
    if len(chosen.cameras) > MAX_CAMERAS:
        raise InputError(
            "--views", f"{len(chosen.cameras)} cameras are too many to train on; the most is {MAX_CAMERAS}"
        )
    # a scene's header has room for so many: of a larger rig, viewers are offered the places that trained
    rig = dataset.upright if len(dataset.cameras) <= MAX_CAMERAS else chosen.upright
    return OpenJob(job, chosen, rig)


def _announced(frames: Iterator[FrameSet], *listeners: Callable[[FrameSet], None]) -> Generator[FrameSet, None, None]:
    for frame in frames:
        for listener in listeners:
            listener(frame)
        yield frame
