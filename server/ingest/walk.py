"""Watches a board walk while it is recorded, and tells what the cameras still need to see of the board.

A look that breaks ends the watch, not the recording.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor

import cv2
import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.board.description import Board
from streamlod.core.calibration.board.detect import Detector
from streamlod.core.calibration.walk_coverage import WalkCoverage, is_seen
from streamlod.core.errors import InputError
from streamlod.server.ingest.board_sight import BoardSight
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.synchroniser import Instant
from streamlod.server.ingest.watch import Watch

_LOOK_SECONDS = 0.4  # between looks, in which a person with a board moves on
_TELL_SECONDS = 8.0
_WIDTH = 640  # pixels of the longer side, or a little more, at which pictures are searched


class WalkWatch:
    """Looks for the board at some instants.

    Args:
        cameras: names, in the order of an instant's pictures.
        tell: told what is needed, whenever that has changed.
        show: given what each camera sees and needs, after each look; nothing once a look broke.
        pool: on whose thread it looks.
        clock: seconds.
    """

    def __init__(
        self,
        cameras: Sequence[str],
        board: Board,
        tell: Callable[[str], object],
        show: Callable[[Mapping[str, BoardSight]], object],
        pool: Executor,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._unseen = f"no camera has seen it, which is to have {board.described()}"
        self._detect, self._tell, self._show, self._pool, self._clock = Detector(board), tell, show, pool, clock
        self._coverage, self._told = WalkCoverage.none(cameras), ""
        self._watch = Watch("the board's walk is no longer watched", lambda: show({}))
        self._look_at, self._tell_at = -np.inf, clock() + _TELL_SECONDS

    def look(self, instant: Instant) -> None:
        """Look at an instant if it is time for it; never waits."""
        now = self._clock()
        if now >= self._look_at and self._watch.begin(lambda: self._take(instant), self._pool):
            self._look_at = now + _LOOK_SECONDS

    def end(self) -> None:
        """Wait for the last look, and tell what is missing in the end."""
        if self._watch.finish():
            self._say()

    def _take(self, instant: Instant) -> None:
        corners = [self._corners(picture) for picture in instant.pictures]
        coverage = self._coverage = self._coverage.after(corners)
        sights = map(BoardSight, map(is_seen, corners), coverage.next_needs())
        self._show(dict(zip(coverage.cameras, sights, strict=True)))
        if self._clock() >= self._tell_at:
            self._tell_at = self._clock() + _TELL_SECONDS
            self._say()

    def _say(self) -> None:
        needs = "; ".join(self._coverage.needs()) or "all cameras have seen enough of it"
        text = f"the board: {needs if self._coverage.begun else self._unseen}"
        if text != self._told:
            self._told = text
            self._tell(text)

    def _corners(self, picture: Picture | None) -> Float64:
        """[J,2] corners from (0, 0) to (1, 1), none where there is no picture."""
        if picture is None:
            return np.zeros((0, 2))
        try:
            pixels = picture.load()
        except InputError:  # damaged
            return np.zeros((0, 2))
        height, width = pixels.shape[:2]
        step = max(1, max(width, height) // _WIDTH)
        small = cv2.resize(pixels, (width // step, height // step), interpolation=cv2.INTER_AREA)
        found = self._detect(np.asarray(small, np.uint8)).corners
        return np.asarray(found / [width // step, height // step], np.float64)
