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

from core.arrays import Float32, Int32
from core.render.backends import Backend
from core.scene.anchors import LATENTS
from core.train.config import PredictConfig
from core.train.control.frame_budget import FixedSteps, FrameProgress
from core.train.field.decode import Splats
from core.train.field.exposure import Exposure
from core.train.field.field import Field
from core.train.field.rounding import dead_zone
from core.train.growth.gradient import GrowthStatistics
from core.train.growth.later import HalfTrained, LaterGrowth
from core.train.growth.new_anchors import added_levels
from core.train.motion.partition import Partition
from core.train.optimise.convergence import EpochProgress
from core.train.optimise.loop import run_steps
from core.train.optimise.losses import photometric_loss
from core.train.optimise.optimisers import Adam, Optimiser
from core.train.optimise.rate import residual_bits
from core.train.optimise.schedule import ViewOrder
from core.train.pictures.views import Views
from core.train.residual.added_anchors import AddedAnchors
from core.train.residual.apply import UnitChange, applied
from core.train.residual.groups import Groups, neighbourhoods
from core.train.residual.search import better_starts
from core.train.residual.state import State
from core.train.residual.tile_cache import TileCache, make_tile_cache
from core.train.residual.update import IntegerUpdate, no_update

_PREPARATION = 0.3  # of a frame's training time, after which no more is planned or searched
_TRANSPARENT = 1 / 255  # opacity below which nothing is drawn


class ResidualTrainer:
    """Fits the residuals of `rows` of `field` to one instant.

    Args:
        state: the state before.
        partition: which anchors to train.
        views: pictures of the instant.
        exposure: of the cameras.
        masks: [C,H,W] bool, pixels that changed.
        useful: cameras to train on, the most important first.
        optimiser: of latents and positions.
        group_cells: width of the neighbourhoods that also move as one, in motion cells (`Octree`); 0 for none.
        guess: [n,3] steps that the anchors may have gone instead of what `state` expects; None for no guess.
    """

    def __init__(
        self,
        state: State,
        partition: Partition,
        views: Views,
        exposure: Exposure,
        masks: Tensor,
        useful: list[int],
        optimiser: Optimiser = Adam(),  # noqa: B008 (frozen)
        group_cells: float = 0.0,
        guess: Tensor | None = None,
    ) -> None:
        scene, field = state.scene, state.field
        trained = torch.from_numpy(partition.trained).to(field.feature.device)
        rows, static = torch.nonzero(trained)[:, 0], torch.nonzero(state.alive & ~trained)[:, 0]
        self._all, self._base, self._views, self._exposure = field, field.with_rows(rows), views, exposure
        self._known, self._useful, self._guess = len(rows), useful, guess
        self._scene, self._alive, self._masks = scene, state.alive, masks
        device = field.feature.device
        black = torch.zeros(3, device=device)
        self._backgrounds = [exposure.behind(black, number) for number in range(len(views.cameras))]
        self._centres = [torch.from_numpy(camera.centre).float().to(device) for camera in views.cameras]
        steps = (scene.weights.feature_decoder, scene.weights.offset_decoder, scene.header.position_steps)
        feature, offset, by_level = (torch.from_numpy(part).to(device) for part in steps)
        self._unit_change = UnitChange(feature, offset, by_level[self._base.level][:, None])
        start = torch.zeros(len(field), LATENTS + 3, device=device) if state.start is None else state.start
        begin = {"latent": start[rows, :LATENTS], "position": start[rows, LATENTS:]}
        self._groups: Groups | None = None
        if group_cells > 0:
            self._groups = neighbourhoods(self._base.position, group_cells * field.octree.motion_cell)
            begin |= self._groups.at_rest()
        leaves = {name: value.clone().requires_grad_() for name, value in begin.items()}
        self._optimiser = optimiser.start(leaves)
        static_splats = _static_splats(field, static, self._centres)
        self._static = [exposure.before(splats, number) for number, splats in enumerate(static_splats)]
        self._shown = state.shown
        self._caches: dict[int, TileCache] = {}
        self._drawn: dict[int, Tensor] = {}
        self._weights: dict[int, Tensor] = {}
        self._added: AddedAnchors | None = None
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
            growth: adds anchors, at most `most_new`; None adds none.
        """
        total = max(config.epochs * len(self._useful), config.minimum_steps)
        pace = progress_of(total)
        views = self._prepare(pace, backend)
        if not views:
            return no_update(self._known)
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
            if waiting is not None and progress >= config.growth_at and len(self._drawn) == len(views):
                self._grow(waiting, most_new)
                waiting = None
            return loss

        losses = run_steps(step, reached)
        if not losses:  # a guess of where things go that no picture has confirmed is not sent, but not forgotten
            return replace(no_update(self._known), complete=False, wanted=self._wanted())
        loss = float(torch.stack(losses[-len(views) :]).mean())
        update = self._integer_update(len(losses), loss)
        return replace(update, complete=epochs.done >= total and len(self._caches) == len(self._useful))

    def _prepare(self, pace: FrameProgress, backend: Backend) -> list[int]:
        """Plan the cameras' pictures, as far as time allows; those that show an anchor to train."""
        views = list[int]()
        with torch.no_grad():
            for number in self._useful:
                if views and pace.progress(0) > _PREPARATION:
                    break
                cache = self._caches[number] = self._cache_of(number, self._dynamic_splats(number), backend)
                if not cache.is_empty:
                    views.append(number)
        return views

    def _begin(self, guess: Tensor, views: list[int]) -> None:
        """Let training begin where `guess` says, for the anchors that it serves."""
        latent, position = (self._optimiser.parameters[name] for name in ("latent", "position"))

        def splats_at(number: int, start: Tensor) -> Splats:
            moved = applied(self._base, latent.detach(), start, self._unit_change)
            return self._exposure.before(moved.decode(self._centres[number]), number)

        starts = better_starts(position.detach(), guess, splats_at, self._draw, self._views.targets, views)
        with torch.no_grad():
            position.copy_(starts)

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
        position = self._position()
        raster, cache = self._caches[number].render(self._dynamic_splats(number, position))
        self._caches[number] = cache
        target, weights = self._views.targets[number], self._pixel_weights(number, config.changed_weight)
        loss = photometric_loss(raster.image, target, config.dssim_weight, cache.region, weights)
        if config.rate_weight:
            bits = residual_bits(self._optimiser.parameters["latent"], position)
            loss = loss + config.rate_weight * bits / raster.image.numel()
        loss.backward()  # type: ignore[no-untyped-call]
        if growth is not None:
            self._drawn[number] = raster.image.detach()
            if growth.uses_gradients:
                self._statistics.add_gradients(raster.probe.visible, raster.probe.gradients.norm(dim=1))
        rates = {"latent": config.latent_rate, "position": config.position_rate}
        rates |= dict.fromkeys(("shift", "turn"), config.group_rate)
        new = {} if self._added is None else self._added.rates(config.position_rate, decay)
        self._optimiser.step({name: rate * decay for name, rate in rates.items()} | new)
        return loss.detach()

    def _pixel_weights(self, number: int, changed_weight: float) -> Tensor | None:
        """[H,W,3] of one picture's absolute errors: those of changed pixels count more."""
        if number not in self._weights and changed_weight:
            counted = 1 + changed_weight * self._masks[number, ..., None].to(self._views.targets.dtype)
            self._weights[number] = counted.expand(-1, -1, 3).contiguous()
        return self._weights.get(number)

    def _cache_of(self, number: int, dynamic: Splats, backend: Backend) -> TileCache:
        camera = self._views.cameras[number]
        known = None if self._shown is None or self._shown[number, 0, 0, 0].isnan() else self._shown[number]
        before = dynamic if known is None else self._base.decode(self._centres[number])
        return make_tile_cache(camera, dynamic, self._static[number], self._backgrounds[number], backend, known, before)

    def _dynamic_field(self, position: Tensor | None = None) -> Field:
        """The dynamic anchors as they will be sent: with their residuals, and then the new ones.

        Args:
            position: what `_position` gives, where it is at hand.
        """
        moved = self._position() if position is None else position
        known = applied(self._base, self._optimiser.parameters["latent"], moved, self._unit_change)
        return known if self._added is None else self._added.behind(known)

    def _position(self) -> Tensor:
        """[n,3] how far each anchor goes in steps, by itself and with its group."""
        parameters = self._optimiser.parameters
        own = parameters["position"]
        return own if self._groups is None else self._groups.moved(own, parameters["shift"], parameters["turn"])

    def _dynamic_splats(self, number: int, position: Tensor | None = None) -> Splats:
        return self._exposure.before(self._dynamic_field(position).decode(self._centres[number]), number)

    def _grow(self, growth: LaterGrowth, most: int) -> None:
        """Add anchors where they are lacking: what has just come into view has none yet."""
        with torch.no_grad():
            trained = self._dynamic_field()
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
        start = growth.new_anchors(seen, torch.Generator().manual_seed(self._known))
        if len(start["level"]):
            self._added = AddedAnchors(start, self._base, self._scene, self._optimiser)

    def _integer_update(self, steps: int, loss: float) -> IntegerUpdate:
        latent, position = map(_finite_integers, (self._optimiser.parameters["latent"], self._position()))
        with torch.no_grad():
            field = self._dynamic_field()
            opacity = field.decode(self._centres[self._views.usable[0]]).opacities.reshape(len(field), -1).amax(dim=1)
        # what looks different to every camera may be transparent to one only
        shown = (opacity > _TRANSPARENT).cpu().numpy() | (not self._all.looks_the_same)
        added = None
        if self._added is not None:
            new = np.flatnonzero(shown[self._known :])
            chosen = field.with_rows(torch.from_numpy(new + self._known).to(opacity.device))
            added = added_levels(chosen, self._added.moved[new], self._scene.header)
        gone = ~shown[: self._known]
        return IntegerUpdate(latent, position, gone, added, steps, loss, self._optimiser.broken, wanted=self._wanted())

    def _wanted(self) -> Float32:
        """[n,27] latents and positions before rounding, of the anchors that were there before."""
        wanted = torch.cat([self._optimiser.parameters["latent"], self._position()], dim=1).detach()
        return np.asarray(wanted.nan_to_num(0.0, 0.0, 0.0).cpu().numpy())


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


def _finite_integers(values: Tensor) -> Int32:
    """Integers as training saw them; what is not finite stays at its last good state, zero."""
    limit = 2.0**24
    rounded = dead_zone(torch.nan_to_num(values.detach(), 0.0, 0.0, 0.0)).clamp(-limit, limit)
    return rounded.to(torch.int32).cpu().numpy()
