"""A refresh keyframe from its request until it is sent: trained at once, or in the time that frame budgets leave."""

from __future__ import annotations

import time
from collections.abc import Callable

from streamlod.core.render.backends import Backend
from streamlod.core.train.config import TrainConfig
from streamlod.core.train.control.frame_budget import FixedSteps, FrameBudget
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.pictures.views import Views
from streamlod.core.train.refresh.background import BackgroundRefresh
from streamlod.core.train.residual.state import State

_STEP = "refresh step"  # of one picture, whose cost the budget learns


class PendingRefresh:
    """Whether a refresh keyframe was requested, and the one in training beside the stream, if any.

    Args:
        config: of the stream.
        budget: of every frame; None for as long as it takes: then a keyframe is ready as soon as it is requested.
        clock: seconds that the budget goes by.
    """

    def __init__(
        self,
        config: TrainConfig,
        backend: Backend,
        budget: FrameBudget | None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._config, self._backend, self._budget, self._clock = config, backend, budget, clock
        self._background: BackgroundRefresh | None = None
        self.is_due = False

    def needs_training(self, state: State) -> bool:
        """Whether a keyframe of `state` is trained at all: it has changed, and training is configured."""
        return self._config.keyframe.refresh_steps > 0 and state.scene.anchor_count > 0 and not state.is_untouched

    def is_ready(self, state: State) -> bool:
        """Whether a keyframe is due and takes no time that a frame budget would miss."""
        trained = self._background is not None and self._background.complete
        return self.is_due and (trained or not self._beside(state))

    def is_beside(self, state: State) -> bool:
        """Whether a keyframe is in training beside the stream, or will be after this frame: no anchor may be added."""
        return self.is_due and self._beside(state)

    def train(self, before: State, after: State, views: Views, exposure: Exposure) -> None:
        """Some steps in the time that is left of a frame that led from `before` to `after`; the first only begins.

        What moves comes first: where its training takes all of the time, the keyframe has none.
        """
        if not self.is_due or not self._beside(after):
            return
        assert self._budget is not None
        if self._background is None:
            self._background = BackgroundRefresh(after, views, self._config, self._backend, exposure)
            return
        begin, steps = self._clock(), self._background.steps
        pace = self._budget.pace(steps, "encode") if self._budget.allows(_STEP, "encode") else FixedSteps(0)
        count = self._background.train(before.field, after.field, views, pace)
        if count:
            self._budget.spent(_STEP, (self._clock() - begin) / count)

    def take(self) -> BackgroundRefresh | None:
        """The keyframe that was trained to its end, if any; nothing is due any more."""
        background, self._background, self.is_due = self._background, None, False
        return background if background is not None and background.complete else None

    def _beside(self, state: State) -> bool:
        """Whether a keyframe of `state` is trained a few steps a frame."""
        return self._budget is not None and self.needs_training(state)
