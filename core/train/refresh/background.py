"""The keyframe to come, trained beside the stream: some steps a frame, so that no frame has to wait for it.

It begins as the state, in floating point, and goes along with every later frame's residual while it learns what
residuals leave undone (sizes, the network, what is not worth its bytes). No anchor grows or goes meanwhile, so each
knows which one of the state it follows.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from core.render.backends import Backend
from core.train.config import TrainConfig
from core.train.control.frame_budget import Pace
from core.train.field.convert import precision_of
from core.train.field.exposure import Exposure
from core.train.field.field import Field
from core.train.field.rounding import Precision
from core.train.keyframe.trainer import KeyframeTrainer
from core.train.optimise.loop import run_steps
from core.train.pictures.views import Views
from core.train.refresh.config import renewal_config
from core.train.residual.state import State

FRAMES = 20  # that its training is spread over
_NEVER = 2.0  # share of a run


class Successor:
    """A keyframe in training.

    Args:
        state: what it begins as. views, exposure: pictures of that instant, and of the cameras.
        config: of the stream.

    Attributes:
        steps: most that a frame should take; taken: by all frames so far.
    """

    def __init__(self, state: State, views: Views, config: TrainConfig, backend: Backend, exposure: Exposure) -> None:
        self._rows = torch.nonzero(state.alive)[:, 0]
        field = state.field.with_rows(self._rows)
        run = renewal_config(config, field, state.scene.version)
        run = replace(run, keyframe=replace(run.keyframe, growth_from=_NEVER))
        self.steps, self.taken, self._course = max(1, run.keyframe.steps // FRAMES), 0, _Course()
        known = precision_of(state.scene, self._rows)
        self._trainer = KeyframeTrainer(field, views, run, backend, exposure, self._course, known)

    @property
    def complete(self) -> bool:
        """Whether it has had its frames."""
        return self._course.progress >= 1

    @property
    def exposure(self) -> Exposure:
        """Gains and offsets fitted so far."""
        return self._trainer.exposure

    def learnt(self, alive: Tensor) -> tuple[Field, Precision]:
        """What has been learnt of those anchors that still live, of `alive` [N] of the state, and its rounding."""
        kept = torch.nonzero(alive[self._rows])[:, 0]
        precision = self._trainer.precision
        return self._trainer.field.with_rows(kept), replace(precision, shift=precision.shift[kept])

    def go_on(self, before: Field, after: Field, views: Views, pace: Pace) -> int:
        """Follow the state from `before` to `after`, both of all its rows, and train on the frame's pictures.

        Args:
            pace: of as many steps as there is time for, at most `steps`.

        Returns:
            Steps taken, which also count in `taken`.
        """
        names, rows = ("feature", "offset", "position"), self._rows
        changes = {name: (getattr(after, name) - getattr(before, name))[rows] for name in names}
        self._trainer.follow(changes, views)

        def progress(steps: int) -> float:
            self._course.part = min(pace.progress(steps), 1.0)
            return self._course.part

        count = len(run_steps(self._trainer.step, progress))
        self._course.next_frame()
        self.taken += count
        return count


class _Course:
    """Progress by frames, however many steps each of them had time for."""

    def __init__(self) -> None:
        self._frame, self.part = 0, 0.0

    @property
    def progress(self) -> float:
        """In [0, 1]."""
        return min((self._frame + self.part) / FRAMES, 1.0)

    def next_frame(self) -> None:
        """The frame has had its steps."""
        self._frame, self.part = self._frame + 1, 0.0

    def advance(self, view: int, loss: Tensor | None) -> None:
        """A step, which counts for nothing by itself."""
