"""Training one later frame: quantised residuals of the dynamic anchors only (paper section IV-C).

The state is the decoder's: every frame starts from dequantised integers and ends by rounding, so encoder and decoder
cannot drift apart. Between the rounds the latents are real numbers whose forward pass is rounded (straight-through).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool
from streamlod.core.render.backends import Backend
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.control.frame_budget import FixedSteps, FrameProgress
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.field.field import Field
from streamlod.core.train.growth.gradient import GrowthStatistics
from streamlod.core.train.growth.later import HalfTrained, LaterGrowth
from streamlod.core.train.optimise.convergence import EpochProgress
from streamlod.core.train.optimise.loop import run_steps
from streamlod.core.train.optimise.losses import photometric_loss
from streamlod.core.train.optimise.schedule import ViewOrder
from streamlod.core.train.pictures.views import Views
from streamlod.core.train.residual.anchors import TrainedAnchors
from streamlod.core.train.residual.search import better_starts
from streamlod.core.train.residual.state import State
from streamlod.core.train.residual.tile_cache import TileCache, make_tile_cache
from streamlod.core.train.residual.update import IntegerUpdate, no_update

_PREPARATION = 0.3  # of a frame's training time, after which no more is planned or searched
_TRANSPARENT = 1 / 255  # opacity below which nothing is drawn


class ResidualTrainer:
    """Fits the residuals of the `dynamic` anchors to one instant.

    Args:
        state: the state before.
        dynamic: [N] bool, the anchors to train.
        views: pictures of the instant.
        exposure: of the cameras.
        masks: [C,H,W] bool, pixels that changed.
        useful: cameras to train on, the most important first.
        memory: Adam's beta_1.
        group_cells: width of the neighbourhoods that also move as one, in motion cells (`Octree`); 0 for none.
        guess: [n,3] steps that the anchors may have gone instead of what `state` expects; None for no guess.
    """

    def __init__(
        self,
        state: State,
        dynamic: Bool,
        views: Views,
        exposure: Exposure,
        masks: Tensor,
        useful: list[int],
        memory: float = 0.9,
        group_cells: float = 0.0,
        guess: Tensor | None = None,
    ) -> None:
        field = state.field
        trained = torch.from_numpy(dynamic).to(field.feature.device)
        rows, static = torch.nonzero(trained)[:, 0], torch.nonzero(state.alive & ~trained)[:, 0]
        self._anchors = TrainedAnchors(state, rows, memory, group_cells)
        self._all, self._views, self._exposure = field, views, exposure
        self._useful, self._guess = useful, guess
        self._alive, self._masks = state.alive, masks
        device = field.feature.device
        black = torch.zeros(3, device=device)
        self._backgrounds = [exposure.behind(black, number) for number in range(len(views.cameras))]
        self._centres = [torch.from_numpy(camera.centre).float().to(device) for camera in views.cameras]
        static_splats = _static_splats(field, static, self._centres)
        self._static = [exposure.before(splats, number) for number, splats in enumerate(static_splats)]
        self._shown = state.shown
        self._caches: dict[int, TileCache] = {}
        self._drawn: dict[int, Tensor] = {}
        self._weights: dict[int, Tensor] = {}
        self._statistics = GrowthStatistics(len(rows), field.slots, device)

    def run(
        self,
        config: PredictConfig,
        backend: Backend,
        generator: torch.Generator,
        progress_of: Callable[[int], FrameProgress] = FixedSteps,
        growth: LaterGrowth | None = None,
        most_new: int = 0,
    ) -> IntegerUpdate:
        """Train as configured and round.

        Args:
            progress_of: makes the pace of a number of steps.
            growth: says where anchors are added; None for nowhere. most_new: that may be added.
        """
        total = max(config.epochs * len(self._useful), config.minimum_steps)
        pace = progress_of(total)
        views = self._prepare(pace, backend)
        if not views:
            return no_update(len(self._anchors))
        if self._guess is not None and pace.progress(0) <= _PREPARATION:
            self._begin(self._guess, views)
        order, epochs = ViewOrder(views, generator), EpochProgress(len(views), config.least_gain)
        progress, waiting = 0.0, growth if most_new else None

        def reached(_: int) -> float:
            nonlocal progress
            progress = pace.progress(epochs.done)
            return progress

        def step() -> Tensor:
            nonlocal waiting
            loss = self._step(order.next(), config, config.final_rate**progress, waiting)
            epochs.advance(loss)
            if progress >= config.average_from:
                self._anchors.average()
            if waiting is not None and progress >= config.growth_at and len(self._drawn) == len(views):
                self._add(waiting, most_new)
                waiting = None
            return loss

        losses = run_steps(step, reached)
        if not losses:  # a guess of where things go that no picture has confirmed is not sent, but not forgotten
            return replace(no_update(len(self._anchors)), complete=False, wanted=self._anchors.wanted())
        self._anchors.settle()
        loss = float(torch.stack(losses[-len(views) :]).mean())
        complete = epochs.done >= total and len(self._caches) == len(self._useful)
        update = self._anchors.update(self._visible(), len(losses), loss)
        return replace(update, complete=complete)

    def _prepare(self, pace: FrameProgress, backend: Backend) -> list[int]:
        """Plan the cameras' pictures, as far as time allows; those that show an anchor to train."""
        views = list[int]()
        with torch.no_grad():
            for number in self._useful:
                if views and pace.progress(0) > _PREPARATION:
                    break
                cache = self._caches[number] = self._cache_of(number, self._splats(number), backend)
                if not cache.is_empty:
                    views.append(number)
        return views

    def _begin(self, guess: Tensor, views: list[int]) -> None:
        """Let training begin where `guess` says, for the anchors that it serves."""

        def splats_at(number: int, start: Tensor) -> Splats:
            return self._filmed(self._anchors.starting_at(start), number)

        usual = self._anchors.optimiser.parameters["position"].detach()
        self._anchors.begin_at(better_starts(usual, guess, splats_at, self._draw, self._views.targets, views))

    def _draw(self, number: int, splats: Splats) -> Tensor:
        raster, self._caches[number] = self._caches[number].render(splats)
        return raster.image

    def show(self, field: Field, rows: Tensor) -> Tensor:
        """[C,H,W,3] what the usable cameras film once `field` has taken over at `rows`; NaN for the others."""
        pictures = torch.full_like(self._views.targets, torch.nan)
        with torch.no_grad():
            for number, cache in self._caches.items():
                splats = field.decode(self._centres[number], rows)
                pictures[number] = cache.render(self._exposure.before(splats, number))[0].image
        return pictures

    def _step(self, number: int, config: PredictConfig, decay: float, growth: LaterGrowth | None = None) -> Tensor:
        """One view, one update; returns the detached loss. `growth` will want to know of it, None for nobody."""
        moves = self._anchors.moves
        raster, cache = self._caches[number].render(self._splats(number, moves))
        self._caches[number] = cache
        loss = self._loss(raster.image, number, config)
        if config.rate_weight:
            loss = loss + config.rate_weight * self._anchors.bits(moves) / raster.image.numel()
        loss.backward()  # type: ignore[no-untyped-call]
        if growth is not None:
            self._drawn[number] = raster.image.detach()
            if growth.uses_gradients:
                self._statistics.add_gradients(raster.probe.visible, raster.probe.gradients.norm(dim=1))
        self._anchors.step(config, decay)
        return loss.detach()

    def _loss(self, image: Tensor, number: int, config: PredictConfig) -> Tensor:
        """[] what is wrong with the picture of a camera."""
        weights, region = self._pixel_weights(number, config.changed_weight), self._caches[number].region
        return photometric_loss(image, self._views.targets[number], config.dssim_weight, region, weights)

    def _pixel_weights(self, number: int, changed_weight: float) -> Tensor | None:
        """[H,W,3] of one picture's absolute errors: those of changed pixels count more."""
        if number not in self._weights and changed_weight:
            counted = 1 + changed_weight * self._masks[number, ..., None].to(self._views.targets.dtype)
            self._weights[number] = counted.expand(-1, -1, 3).contiguous()
        return self._weights.get(number)

    def _cache_of(self, number: int, trained: Splats, backend: Backend) -> TileCache:
        camera = self._views.cameras[number]
        known = None if self._shown is None or self._shown[number, 0, 0, 0].isnan() else self._shown[number]
        before = trained if known is None else self._anchors.base.decode(self._centres[number])
        return make_tile_cache(camera, trained, self._static[number], self._backgrounds[number], backend, known, before)

    def _splats(self, number: int, moves: Tensor | None = None) -> Splats:
        """The Gaussians of the anchors in training, as they will be sent, for a camera."""
        return self._filmed(self._anchors.field(moves), number)

    def _filmed(self, field: Field, number: int) -> Splats:
        return self._exposure.before(field.decode(self._centres[number]), number)

    def _add(self, growth: LaterGrowth, most: int) -> None:
        """Add at most `most` anchors where they are lacking."""
        with torch.no_grad():
            trained = self._anchors.by_residuals()
        seen = HalfTrained(
            trained=trained,
            living=self._all.with_rows(torch.nonzero(self._alive)[:, 0]),
            every=self._all,
            statistics=self._statistics,
            views=self._views,
            drawn=self._drawn,
            masks=self._masks,
            most=most,
        )
        self._anchors.add(growth.new_anchors(seen, torch.Generator().manual_seed(len(self._anchors))))

    @torch.no_grad()
    def _visible(self) -> Bool:
        """For each anchor as it will be sent, whether any camera may see it."""
        field = self._anchors.field()
        if not self._all.looks_the_same:  # what is transparent to one camera may not be so to another
            return np.ones(len(field), np.bool_)
        opacity = field.decode(self._centres[self._views.usable[0]]).opacities.reshape(len(field), -1).amax(dim=1)
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
