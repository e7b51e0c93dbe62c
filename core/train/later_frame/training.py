"""Training of one later frame: quantised residuals of the dynamic anchors only (paper section IV-C).

The state is the decoder's: every frame starts from dequantised integers and ends by rounding, so encoder and decoder
cannot drift apart. Between the rounds the latents are real numbers whose forward pass is rounded (straight-through).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool
from streamlod.core.render.raster import Raster
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.control.frame_budget import Pace, fixed_steps
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.field.field import Field
from streamlod.core.train.later_frame.anchors import TrainedAnchors
from streamlod.core.train.later_frame.comparison import Beginning
from streamlod.core.train.later_frame.engine import EngineMaker, FrameTask
from streamlod.core.train.later_frame.pixel_steps import steps_a_pixel
from streamlod.core.train.later_frame.steps import steps_of
from streamlod.core.train.later_frame.update import IntegerUpdate, no_update
from streamlod.core.train.optimise.schedule import view_order

_PREPARATION = 0.3  # of a frame's training time, after which no more is planned or searched
_TRANSPARENT = 1 / 255  # opacity below which nothing is drawn


class Hooks:
    """What a part does during one frame; every hook does nothing unless a part overrides it."""

    def ready(self, training: FrameTraining) -> None:
        """The pictures are planned, and no step has been taken."""

    def stepped(self, training: FrameTraining, number: int, raster: Raster, progress: float) -> None:
        """A step on camera `number` was taken, `progress` of the frame (0 to 1) is done."""


class FrameTraining:
    """Fits the residuals of some anchors to one instant.

    Attributes:
        anchors: in training.
        numbers: cameras whose pictures show any of them.
        engine: draws, and takes the steps.

    Args:
        seen: the state before, the anchors to train, and the pictures.
        hooks: of the parts that take part, begun with `seen`.
        exposure: of the cameras.
        useful: cameras to train on, the most important first.
        engine_of: makes the engine.
        config: of later frames, after rate control.
    """

    def __init__(
        self,
        seen: Beginning,
        hooks: Sequence[Hooks],
        exposure: Exposure,
        useful: list[int],
        engine_of: EngineMaker,
        config: PredictConfig,
    ) -> None:
        state, views = seen.state, seen.pictures.views
        cameras = [views.cameras[number] for number in views.usable]
        pixels = steps_a_pixel(state.field.with_rows(seen.rows), state.scene.header.position_steps, cameras)
        self.anchors = TrainedAnchors(state, seen.rows, pixels, config.memory)
        self.numbers = list[int]()
        self._seen, self._hooks, self._useful, self._config = seen, hooks, useful, config
        self._task = FrameTask(seen, self.anchors, exposure, config)
        self.engine = engine_of(self._task)
        self._planned = list[int]()

    def run(self, generator: torch.Generator, pace_of: Callable[[int], Pace] = fixed_steps) -> IntegerUpdate:
        """Train as configured and round.

        Args:
            pace_of: makes the pace of a number of steps.
        """
        config, total = self._config, steps_of(self._config, self._seen.pictures.masks[self._useful])
        pace = pace_of(total)
        self._prepare(pace)
        if not self.numbers:
            return no_update(len(self.anchors))
        if pace(0) <= _PREPARATION:
            for hooks in self._hooks:
                hooks.ready(self)
        order, losses = view_order(self.numbers, generator), list[Tensor]()
        is_whole = self._seen.coarse is self._seen.pictures
        while (progress := pace(len(losses))) < 1:
            if not is_whole and progress >= config.half_size_until:
                self.engine.enlarge()
                is_whole = True
            number = next(order)
            counts = progress >= config.average_from
            loss, raster = self.engine.step(number, config.final_rate**progress, counts=counts)
            losses.append(loss)
            if is_whole:
                for hooks in self._hooks:
                    hooks.stepped(self, number, raster, progress)
        if not losses:  # a guess of where things go that no picture has confirmed is not sent
            return replace(no_update(len(self.anchors)), complete=False)
        self.engine.finish()
        last = float(torch.stack(losses[-len(self.numbers) :]).mean())
        update = self.anchors.update(self._visible(), len(losses), last)
        return replace(update, complete=len(losses) >= total and len(self._planned) == len(self._useful))

    def splats_at(self, number: int, position: Tensor) -> Splats:
        """The Gaussians of the anchors for a camera, if these had gone `position` [n,3] steps."""
        return self._task.filmed(self.anchors.starting_at(position), number)

    def show(self, field: Field, rows: Tensor) -> Tensor:
        """[C,H,W,3] what the cameras film once `field` has taken over at `rows`; as before where nothing changed.

        NaN for a camera that nobody had time for, and for one of which nothing was known.
        """
        pictures = self._seen.state.known.shown.clone()
        pictures[[number for number in self._useful if number not in self._planned]] = torch.nan
        with torch.no_grad():
            for number in self._planned:
                pictures[number] = self.engine.show(number, self._task.filmed(field.with_rows(rows), number))
        return pictures

    def _prepare(self, pace: Pace) -> None:
        """Plan the cameras' pictures, as far as time allows."""
        for number in self._useful:
            if self.numbers and pace(0) > _PREPARATION:
                break
            self._planned.append(number)
            if self.engine.plan(number):
                self.numbers.append(number)

    @torch.no_grad()
    def _visible(self) -> Bool:
        """For each anchor as it will be sent, whether any camera may see it."""
        field = self.anchors.field()
        if not field.looks_the_same:  # what is transparent to one camera may not be so to another
            return np.ones(len(field), np.bool_)
        opacity = field.decode(self._seen.pictures.views.centres[0]).opacities.reshape(len(field), -1).amax(dim=1)
        return np.asarray((opacity > _TRANSPARENT).cpu().numpy())
