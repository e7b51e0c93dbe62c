"""From pictures to packets, in three stages side by side.

While frame t trains, pictures of frame t + 1 are read, and frame t - 1 is encoded and passed on. This is what the
worker process runs; `clip` writes the packets into a file.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import closing

from streamlod.core.scene.anchors import Scene
from streamlod.core.train import Progress
from streamlod.server.pipeline.stages.bounded_queue import Outlet, made_by
from streamlod.server.pipeline.stages.encoding import EncodedFrame, KeyframeSize, TrainedState, encoded
from streamlod.server.pipeline.stages.opened import OpenJob
from streamlod.server.pipeline.stages.training import TrainingStage


def train_stream(
    opened: OpenJob,
    *,
    resume: Scene | None = None,
    start: int = 0,
    previews: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> Generator[EncodedFrame, None, None]:
    """Train the job's frames in order on a thread, and encode each one while the next trains.

    A version counts published states; it equals the frame's index unless previews or a resumed state came before. An
    error of any stage is raised here, after the frames before it. A frame is given out when all its packets are made.

    Args:
        resume: continue from this keyframe, which has been published, instead of training one; `opened` has to be
            `continuing` from it.
        start: first frame to read.
        previews: also yield early keyframes while the first frame trains, for viewers that are waiting.
        on_progress: called on the training thread.
    """
    size = KeyframeSize()

    def train(outlet: Outlet[TrainedState]) -> None:
        TrainingStage(opened, previews, on_progress, size, outlet).run(resume, start)

    # close the cameras first: training that waits for them could not be ended
    with closing(made_by(train, "training")) as trained, closing(opened):
        for state in trained:
            yield encoded(state, size, opened.facts)
