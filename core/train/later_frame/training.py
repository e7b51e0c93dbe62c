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
from streamlod.core.render.backends import Backend
from streamlod.core.render.raster import Raster
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.control.frame_budget import Pace, fixed_steps
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.field.field import Field
from streamlod.core.train.later_frame.anchors import TrainedAnchors
from streamlod.core.train.later_frame.comparison import Beginning, Comparison
from streamlod.core.train.later_frame.pixel_steps import steps_a_pixel
from streamlod.core.train.later_frame.planned import PlannedView, planned_view
from streamlod.core.train.later_frame.steps import steps_of
from streamlod.core.train.later_frame.update import IntegerUpdate, no_update
from streamlod.core.train.loss.photometric import photometric_loss
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

    Args:
        seen: the state before, the anchors to train, and the pictures.
        hooks: of the parts that take part, begun with `seen`.
        exposure: of the cameras.
        useful: cameras to train on, the most important first.
        backend: of the rasteriser.
        config: of later frames, after rate control.
    """

    def __init__(
        self,
        seen: Beginning,
        hooks: Sequence[Hooks],
        exposure: Exposure,
        useful: list[int],
        backend: Backend,
        config: PredictConfig,
    ) -> None:
        state, views = seen.state, seen.pictures.views
        cameras = [views.cameras[number] for number in views.usable]
        pixels = steps_a_pixel(state.field.with_rows(seen.rows), state.scene.header.position_steps, cameras)
        self.anchors = TrainedAnchors(state, seen.rows, pixels, config.memory)
        self.numbers = list[int]()
        self._seen, self._hooks, self._exposure, self._useful = seen, hooks, exposure, useful
        self._backend, self._config, self._centres = backend, config, views.centres
        others = torch.nonzero(state.alive.index_fill(0, seen.rows, False))[:, 0]
        static = enumerate(_static_splats(state.field, others, self._centres))
        self._static = [exposure.before(splats, number) for number, splats in static]
        self._whole: dict[int, PlannedView] = {}
        self._half: dict[int, PlannedView] | None = {} if seen.coarse is not seen.pictures else None

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
        while (progress := pace(len(losses))) < 1:
            if progress >= config.half_size_until:
                self._half = None
            number = next(order)
            loss, raster = self._step(number, config.final_rate**progress)
            losses.append(loss)
            if progress >= config.average_from:
                self.anchors.optimiser.average()
            if self._half is None:
                for hooks in self._hooks:
                    hooks.stepped(self, number, raster, progress)
        if not losses:  # a guess of where things go that no picture has confirmed is not sent
            return replace(no_update(len(self.anchors)), complete=False)
        self.anchors.settle()
        last = float(torch.stack(losses[-len(self.numbers) :]).mean())
        update = self.anchors.update(self._visible(), len(losses), last)
        return replace(update, complete=len(losses) >= total and len(self._whole) == len(self._useful))

    def splats_at(self, number: int, position: Tensor) -> Splats:
        """The Gaussians of the anchors for a camera, if these had gone `position` [n,3] steps."""
        return self._filmed(self.anchors.starting_at(position), number)

    def draw_two(self, number: int, first: Splats, second: Splats) -> tuple[Tensor, Tensor]:
        """[h,w,3] what a camera films of Gaussians in two places, before all that is not trained.

        They need to be right only where they differ: elsewhere, neither may be drawn.
        """
        one, other = self._planned(number).cache.render_two(first, second)
        return one.image, other.image

    def target(self, number: int) -> Tensor:
        """[h,w,3] what a camera should film, of the size of `draw_two`."""
        return self._planned(number).target

    def show(self, field: Field, rows: Tensor) -> Tensor:
        """[C,H,W,3] what the cameras film once `field` has taken over at `rows`; as before where nothing changed.

        NaN for a camera that nobody had time for, and for one of which nothing was known.
        """
        pictures = self._seen.state.known.shown.clone()
        pictures[[number for number in self._useful if number not in self._whole]] = torch.nan
        with torch.no_grad():
            for number, view in self._whole.items():
                pictures[number] = view.cache.render_exactly(self._filmed(field.with_rows(rows), number)).image
        return pictures

    def _prepare(self, pace: Pace) -> None:
        """Plan the cameras' pictures, as far as time allows."""
        for number in self._useful:
            if self.numbers and pace(0) > _PREPARATION:
                break
            self._whole[number] = self._plan(self._seen.pictures, number)
            if not self._whole[number].cache.is_empty:
                self.numbers.append(number)

    def _planned(self, number: int) -> PlannedView:
        """Camera `number` at the size that is trained now."""
        if self._half is None:
            return self._whole[number]
        if number not in self._half:
            view = self._plan(self._seen.coarse, number)
            self._half[number] = view.allowing_for_size(self._filmed(self.anchors.base, number))
        return self._half[number]

    @torch.no_grad()
    def _plan(self, pictures: Comparison, number: int) -> PlannedView:
        static, background = self._static[number], self._exposure.offset[number]
        changed_weight = self._config.changed_weight
        return planned_view(pictures, number, self._splats(number), static, background, self._backend, changed_weight)

    def _step(self, number: int, decay: float) -> tuple[Tensor, Raster]:
        """One view, one update; returns the detached loss, and what was drawn."""
        config, view, moves = self._config, self._planned(number), self.anchors.moves
        raster = view.cache.render(self._splats(number, moves))
        loss = photometric_loss(raster.image, view.target, config.dssim_weight, view.cache.region, view.weights)
        if config.rate_weight:
            loss = loss + config.rate_weight * self.anchors.bits(moves) / self._whole[number].target.numel()
        loss.backward()  # type: ignore[no-untyped-call]
        self.anchors.step(config, decay)
        return loss.detach(), raster

    def _splats(self, number: int, moves: Tensor | None = None) -> Splats:
        """The Gaussians of the anchors in training, as they will be sent, for a camera."""
        return self._filmed(self.anchors.field(moves), number)

    def _filmed(self, field: Field, number: int) -> Splats:
        return self._exposure.before(field.decode(self._centres[number]), number)

    @torch.no_grad()
    def _visible(self) -> Bool:
        """For each anchor as it will be sent, whether any camera may see it."""
        field = self.anchors.field()
        if not field.looks_the_same:  # what is transparent to one camera may not be so to another
            return np.ones(len(field), np.bool_)
        opacity = field.decode(self._centres[0]).opacities.reshape(len(field), -1).amax(dim=1)
        return np.asarray((opacity > _TRANSPARENT).cpu().numpy())


def _static_splats(field: Field, static: Tensor, centres: list[Tensor]) -> list[Splats]:
    """Gaussians that are only drawn, for each camera; decoded once for all where they look the same to all."""
    decoded: list[Splats] = []
    for centre in centres:
        if decoded and field.looks_the_same:
            decoded.append(decoded[0])
            continue
        with torch.no_grad():
            splats = field.decode(centre, static)
        decoded.append(splats.rows(torch.nonzero(splats.opacities > 0)[:, 0]))
    return decoded
