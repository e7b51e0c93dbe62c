"""What a worker tells while it trains."""

from __future__ import annotations

import multiprocessing

import numpy as np

from streamlod.core.frames import FrameSet
from streamlod.server.worker.camera_pictures import CameraPictures
from streamlod.server.worker.messages import Sender
from streamlod.server.worker.training import tell
from tests.core.data.writers import rig


class _Filmed:
    """A job without figures."""

    def statistics(self) -> None:
        return None


def test_what_tells_of_cameras_ends_quietly_with_the_server() -> None:
    ours, theirs = multiprocessing.Pipe(duplex=False)
    ours.close()
    pictures, job = CameraPictures(rig(["cam"], (8, 8))), _Filmed()
    pictures.note(FrameSet(0, 0, np.zeros((1, 8, 8, 3), np.uint8), np.ones(1, np.bool_)))
    with theirs:
        tell(job, pictures, Sender(theirs))  # type: ignore[arg-type]
