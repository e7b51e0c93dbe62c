"""A refresh keyframe trained beside the stream, a few steps a frame, so that no frame has to wait for it.

It starts as a floating-point copy of the state. Every later frame's residual is added to it, while training improves
what residuals cannot change (sizes and the network) or what was not worth its bytes. No anchor is added or removed
meanwhile, so its rows stay those of the state; in the end, those that have faded are left out.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from streamlod.core.render.backends import Backend
from streamlod.core.train.config import TrainConfig
from streamlod.core.train.control.frame_budget import FrameProgress
from streamlod.core.train.field.convert import precision_of
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.field.field import Field
from streamlod.core.train.field.rounding import Precision
from streamlod.core.train.keyframe.trainer import KeyframeTrainer
from streamlod.core.train.optimise.loop import run_steps
from streamlod.core.train.pictures.views import Views
from streamlod.core.train.refresh.config import refresh_config
from streamlod.core.train.residual.state import State

FRAMES = 20  # over which its training is spread
_NEVER = 2.0  # share of a run, which ends at 1


class BackgroundRefresh:
    """A refresh keyframe in training.

    Args:
        state: what it begins as. views, exposure: pictures of that instant, and of the cameras.
        config: of the stream.

    Attributes:
        steps: most that a frame should take; taken: by all frames so far.
    """

    def __init__(self, state: State, views: Views, config: TrainConfig, backend: Backend, exposure: Exposure) -> None:
        self._rows = torch.nonzero(state.alive)[:, 0]
        field = state.field.with_rows(self._rows)
        run = refresh_config(config, field, state.scene.version)
        run = replace(run, keyframe=replace(run.keyframe, growth_from=_NEVER))
        self.steps, self.taken, self._by_frames = max(1, run.keyframe.steps // FRAMES), 0, _ProgressByFrames()
        known = precision_of(state.scene, self._rows)
        self._centres = [torch.from_numpy(camera.centre).float().to(field.feature.device) for camera in views.cameras]
        self._least_opacity = run.keyframe.prune_opacity
        self._trainer = KeyframeTrainer(field, views, run, backend, exposure, self._by_frames, known)

    @property
    def complete(self) -> bool:
        """Whether it has had its frames."""
        return self._by_frames.progress >= 1

    @property
    def exposure(self) -> Exposure:
        """Gains and offsets fitted so far."""
        return self._trainer.exposure

    def result(self, alive: Tensor) -> tuple[Field, Precision]:
        """The trained anchors that are still `alive` [N] in the state and not too faint, and how they are rounded."""
        field, precision = self._trainer.field, self._trainer.precision
        living = alive[self._rows]
        shown = living & (_opacity(field, self._centres) >= self._least_opacity)
        kept = torch.nonzero(shown if bool(shown.any()) else living)[:, 0]  # from nothing, nothing would ever grow
        return field.with_rows(kept), replace(precision, shift=precision.shift[kept])

    def train(self, before: Field, after: Field, views: Views, pace: FrameProgress) -> int:
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
            self._by_frames.part = min(pace.progress(steps), 1.0)
            return self._by_frames.part

        count = len(run_steps(self._trainer.step, progress))
        self._by_frames.next_frame()
        self.taken += count
        return count


@torch.no_grad()
def _opacity(field: Field, centres: list[Tensor]) -> Tensor:
    """[N] of each anchor's Gaussians together, drawn or not, as the camera sees them that sees most of them."""
    field = replace(field, by_distance=False)
    seen = [
        field.decode(centre).opacities.clamp(min=0).reshape(len(field), -1).sum(dim=1)
        for centre in (centres[:1] if field.looks_the_same else centres)
    ]
    return torch.stack(seen).amax(dim=0)


class _ProgressByFrames:
    """Progress of a run by frames, however many steps each of them had time for."""

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
        """One step is done; only frames count."""
