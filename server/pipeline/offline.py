"""Training of a recording from Python: a job in, a file and its figures out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from streamlod.codec.snapshots import check_slod_output
from streamlod.server.pipeline.clip import train_clip
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.sound import AUTO
from streamlod.server.pipeline.stages.encoding import EncodedFrame
from streamlod.server.pipeline.stages.opened import open_job


@dataclass(frozen=True, slots=True)
class TrainingFigures:
    """The outcome of a training.

    Attributes:
        frames: number of frames in the file.
        size_bytes: of the file.
        seconds: from the beginning to the end.
    """

    frames: int
    size_bytes: int
    seconds: float


def train_recording(
    job: TrainJob, out: Path | str, on_frame: Callable[[EncodedFrame], None] = lambda _: None, sound: str = AUTO
) -> TrainingFigures:
    """Train a job into the `.slod` file `out`, which appears when it is complete; figures and sound go beside it.

    Args:
        job: the recording and the settings; ``TrainJob(data="clip", test=["cam00"])``.
        on_frame: called with each frame as soon as it is written.
        sound: ``auto`` for that of the first camera that has some, ``none``, a camera's name, or a file.

    Raises:
        InputError: the recording, the choice of cameras or the place of the file cannot be used.
        BackendUnavailable: the device that the job asks for is not there.
        TrainingCutShort: a fault after the first frame; the file is whole and holds the frames before it.
    """
    begin, count, path = time.perf_counter(), 0, Path(out)
    check_slod_output(path)

    def counted(frame: EncodedFrame) -> None:
        nonlocal count
        count += 1
        on_frame(frame)

    train_clip(open_job(job), path, counted, sound=sound)
    return TrainingFigures(count, path.stat().st_size, time.perf_counter() - begin)
