"""Engines of later frames: the interface by which a frame draws its pictures and takes its training steps.

`core.train.later_frame.autograd.engine` is the usual one, `core.train.engine.warp.frame_engine` the one whose steps are
recorded as a graph.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from streamlod.core.render.raster import Raster
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.field.field import Field
from streamlod.core.train.later_frame.anchors import TrainedAnchors
from streamlod.core.train.later_frame.comparison import Beginning


@dataclass(frozen=True, slots=True, eq=False)
class FrameTask:
    """What an engine is to train.

    Attributes:
        seen: the state before, the anchors to train, and the pictures.
        anchors: the numbers in training; an engine starts from them and leaves its result there.
        exposure: of the cameras.
        config: of later frames, after rate control.
    """

    seen: Beginning
    anchors: TrainedAnchors
    exposure: Exposure
    config: PredictConfig

    def filmed(self, field: Field, number: int) -> Splats:
        """The Gaussians of `field` as camera `number` films them."""
        return self.exposure.before(field.decode(self.seen.pictures.views.centres[number]), number)

    @torch.no_grad()
    def still_splats(self) -> list[Splats]:
        """Gaussians that are only drawn, for each camera, unexposed; one object where all see the same."""
        state, decoded = self.seen.state, list[Splats]()
        others = torch.nonzero(state.alive.index_fill(0, self.seen.rows, False))[:, 0]
        for centre in self.seen.pictures.views.centres:
            if decoded and state.field.looks_the_same:
                decoded.append(decoded[0])
                continue
            splats = state.field.decode(centre, others)
            decoded.append(splats.rows(torch.nonzero(splats.opacities > 0)[:, 0]))
        return decoded


class FrameEngine(Protocol):
    """Draws the pictures of one frame's training and takes its steps."""

    def plan(self, number: int) -> bool:
        """Make camera `number` ready; returns whether any anchor in training reaches its picture."""

    def enlarge(self) -> None:
        """Let all further steps be taken on pictures of full size."""

    def step(self, number: int, decay: float, *, counts: bool) -> tuple[Tensor, Raster]:
        """One step on the picture of a planned camera; returns the loss [], detached, and what was drawn before it.

        Args:
            decay: share to which the rates have fallen. counts: into the mean of the last steps.
        """

    def finish(self) -> None:
        """Leave in the task's anchors what was trained: the mean of the steps that count, if any do."""

    def draw_two(self, number: int, first: Splats, second: Splats) -> tuple[Tensor, Tensor]:
        """[h,w,3] what a camera films of Gaussians in two places, before all that is not trained.

        The pictures can be differentiated by colours, and need to be right only where they differ.
        """

    def target(self, number: int) -> Tensor:
        """[h,w,3] what a camera should film, of the size of `draw_two`."""

    def show(self, number: int, splats: Splats) -> Tensor:
        """[H,W,3] what a planned camera films of `splats` before all that is not trained, at full size."""


EngineMaker = Callable[[FrameTask], FrameEngine]
