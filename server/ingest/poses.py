"""Watches whether the poses of a rig hold for what its cameras film, in a hundredth of the time.

The first look is at the first instant, before anything is trained: who moved a camera after calibrating, or gave two
phones each other's names, is told before the first picture, which waits up to a minute for it to be put right: what was
trained with wrong poses takes minutes to come right. A look compares what two and three cameras share with their poses,
as `streamlod check` does, in smaller pictures. Cameras that share too little with others are not judged. Where poses do
not hold, or another phone films as one of the cameras, looks take a tenth of the time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import cv2
import numpy as np

from streamlod.core.arrays import Bool, UInt8
from streamlod.core.calibration.checks import poses
from streamlod.core.calibration.checks.agreement import agreements
from streamlod.core.calibration.checks.matches import PairMatches, matched
from streamlod.core.data.lens import Undistortion
from streamlod.server.ingest.watch import Watch

_SHARE = 0.01  # of the time that looking may take
_URGENT_SHARE = 0.1  # the same while poses do not hold, so that who mends it soon knows, and after a change of hands
_URGENT_SECONDS = 60.0  # after such a change
_MENDING_SECONDS = 60.0  # that people have for it before the first picture
_SIDE = 640  # pixels of the longer side of what is looked at; larger pictures take longer and tell little more


class PoseWatch:
    """The cameras of a rig.

    Args:
        plans: what makes the cameras' pictures fit their poses.
        tell: told by each look, as soon as it ends, a sentence about each fault that it found.
        clock: seconds.
    """

    def __init__(
        self,
        plans: Sequence[Undistortion],
        tell: Callable[[tuple[str, ...]], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._plans, self._tell, self._clock = tuple(plans), tell, clock
        self._seen = np.zeros(len(self._plans), np.bool_)
        self._began: float | None = None
        self._ended, self._took, self._urgent_until = -np.inf, 0.0, -np.inf
        self._changes: Sequence[int] = ()
        self._holds = True
        self._watch = Watch("poses are no longer compared with the pictures", lambda: tell(()))

    def is_to_be_put_right(self, images: UInt8, present: Bool, pool: Executor) -> bool:
        """Look at pictures [C,H,W,3] of which a scene would be trained; whether it is to wait, as poses do not hold.

        True for a minute at most.
        """
        self._began = self._clock() if self._began is None else self._began
        if self._clock() - self._began >= _MENDING_SECONDS:
            return False
        self._watch.begin(lambda: self._look(images, present), pool)
        return self._watch.finish() and not self._holds

    def look(self, images: UInt8, present: Bool, pool: Executor, changes: Sequence[int] = ()) -> None:
        """Look at the newest pictures [C,H,W,3] on a thread of `pool`, if it is time or a camera is seen first.

        Args:
            changes: how often somebody else began to send the pictures, by camera.
        """
        now = self._clock()
        if changes != self._changes:
            self._changes, self._urgent_until = changes, now + _URGENT_SECONDS
        share = _SHARE if self._holds and now > self._urgent_until else _URGENT_SHARE
        if now >= self._ended + self._took / share or (present & ~self._seen).any():
            self._watch.begin(lambda: self._look(images, present), pool)

    def _look(self, images: UInt8, present: Bool) -> None:
        begin = self._clock()
        plans = [plan for plan, is_present in zip(self._plans, present, strict=True) if is_present]
        pairs = _shared(images[present])
        found = poses.judged(agreements(pairs, [plan.camera for plan in plans]), pairs, plans)
        faults = tuple(finding.sentence for finding in found if finding.severity == "fault")
        self._holds = not faults
        self._tell(faults)
        self._seen |= present
        self._ended = self._clock()
        self._took = self._ended - begin


def _shared(images: UInt8) -> list[PairMatches]:
    """Matches of pictures [C,H,W,3], in their pixels."""
    height, width = images.shape[1:3]
    scale = min(1.0, _SIDE / max(height, width))
    size = max(round(scale * width), 1), max(round(scale * height), 1)
    small = [np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8) for image in images]
    to_large = np.array([width / size[0], height / size[1]])
    return [replace(pair, points=pair.points * to_large) for pair in matched(small)]
