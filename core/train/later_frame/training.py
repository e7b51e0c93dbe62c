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
from streamlod.core.train.later_frame.comparison import Beginning
from streamlod.core.train.later_frame.pixel_steps import steps_a_pixel
from streamlod.core.train.later_frame.planned import PlannedViews
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
        memory: Adam's beta_1.
    """

    def __init__(
        self,
        seen: Beginning,
        hooks: Sequence[Hooks],
        exposure: Exposure,
        useful: list[int],
        backend: Backend,
        memory: float = 0.9,
    ) -> None:
        state, views = seen.state, seen.pictures.views
        field = state.field
        others = state.alive.index_fill(0, seen.rows, False)
        cameras = [views.cameras[number] for number in views.usable]
        pixels = steps_a_pixel(field.with_rows(seen.rows), state.scene.header.position_steps, cameras)
        self.anchors = TrainedAnchors(state, seen.rows, pixels, memory)
        self._hooks, self._all, self._exposure, self._useful = hooks, field, exposure, useful
        self._shown = state.known.shown
        self._centres = views.centres
        static_splats = _static_splats(field, torch.nonzero(others)[:, 0], self._centres)
        static = [exposure.before(splats, number) for number, splats in enumerate(static_splats)]
        self._whole = PlannedViews(seen.pictures, static, exposure.offset, backend)
        self._half: PlannedViews | None = None
        if seen.coarse is not seen.pictures:
            self._half = PlannedViews(seen.coarse, static, exposure.offset, backend)
        self.numbers = list[int]()

    def run(
        self,
        config: PredictConfig,
        generator: torch.Generator,
        pace_of: Callable[[int], Pace] = fixed_steps,
    ) -> IntegerUpdate:
        """Train as configured and round.

        Args:
            pace_of: makes the pace of a number of steps.
        """
        total = steps_of(config, self._whole.pictures.masks[self._useful])
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
            loss, raster = self._step(number, config, config.final_rate**progress)
            losses.append(loss)
            if progress >= config.average_from:
                self.anchors.average()
            if self._half is None:
                for hooks in self._hooks:
                    hooks.stepped(self, number, raster, progress)
        if not losses:  # a guess of where things go that no picture has confirmed is not sent
            return replace(no_update(len(self.anchors)), complete=False)
        self.anchors.settle()
        last = float(torch.stack(losses[-len(self.numbers) :]).mean())
        update = self.anchors.update(self._visible(), len(losses), last)
        return replace(update, complete=len(losses) >= total and len(self._whole.caches) == len(self._useful))

    def splats_at(self, number: int, position: Tensor) -> Splats:
        """The Gaussians of the anchors for a camera, if these had gone `position` [n,3] steps."""
        return self._filmed(self.anchors.starting_at(position), number)

    def draw_two(self, number: int, first: Splats, second: Splats) -> tuple[Tensor, Tensor]:
        """[h,w,3] what a camera films of Gaussians in two places, before all that is not trained.

        They need to be right only where they differ: elsewhere, neither may be drawn.
        """
        one, other = self._planned(number).caches[number].render_two(first, second)
        return one.image, other.image

    def target(self, number: int) -> Tensor:
        """[h,w,3] what a camera should film, of the size of `draw_two`."""
        return self._planned(number).pictures.views.targets[number]

    def show(self, field: Field, rows: Tensor) -> Tensor:
        """[C,H,W,3] what the cameras film once `field` has taken over at `rows`; as before where nothing changed.

        NaN for a camera that nobody had time for, and for one of which nothing was known.
        """
        pictures = self._shown.clone()
        pictures[[number for number in self._useful if number not in self._whole.caches]] = torch.nan
        with torch.no_grad():
            for number, cache in self._whole.caches.items():
                splats = field.decode(self._centres[number], rows)
                pictures[number] = cache.render_exactly(self._exposure.before(splats, number)).image
        return pictures

    def _prepare(self, pace: Pace) -> None:
        """Plan the cameras' pictures, as far as time allows."""
        with torch.no_grad():
            for number in self._useful:
                if self.numbers and pace(0) > _PREPARATION:
                    break
                if not self._whole.plan(number, self._splats(number)).is_empty:
                    self.numbers.append(number)

    def _planned(self, number: int) -> PlannedViews:
        """The pictures of the size that is trained now, that of camera `number` planned."""
        if self._half is None:
            return self._whole
        if number not in self._half.caches:
            with torch.no_grad():
                self._half.plan(number, self._splats(number))
            self._half.allow_for_size(number, self._filmed(self.anchors.base, number))
        return self._half

    def _step(self, number: int, config: PredictConfig, decay: float) -> tuple[Tensor, Raster]:
        """One view, one update; returns the detached loss, and what was drawn."""
        planned, moves = self._planned(number), self.anchors.moves
        splats, cache = self._splats(number, moves), planned.caches[number]
        raster = cache.render(splats)
        target, weights = self.target(number), planned.pixel_weights(number, config.changed_weight)
        loss = photometric_loss(raster.image, target, config.dssim_weight, cache.region, weights)
        if config.rate_weight:
            numbers = self._whole.pictures.views.targets[number].numel()
            loss = loss + config.rate_weight * self.anchors.bits(moves) / numbers
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
        if not self._all.looks_the_same:  # what is transparent to one camera may not be so to another
            return np.ones(len(field), np.bool_)
        opacity = (
            field.decode(self._centres[self._whole.pictures.views.usable[0]])
            .opacities.reshape(len(field), -1)
            .amax(dim=1)
        )
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
