"""Training the first frame: an anchor model from nothing but points and pictures (paper section IV-A)."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from streamlod.core.render.backends import Backend
from streamlod.core.render.raster import Raster
from streamlod.core.scene.octree import narrowest_cell
from streamlod.core.train.config import KeyframeConfig, TrainConfig
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.field.field import Field, visible_levels
from streamlod.core.train.field.learned import LearnedField
from streamlod.core.train.field.rounding import Precision, usual_precision
from streamlod.core.train.growth.near_space import NearSpace
from streamlod.core.train.growth.refine import refine
from streamlod.core.train.keyframe.drawing import ViewLoss
from streamlod.core.train.keyframe.measured import effects_and_rest, precision_within
from streamlod.core.train.keyframe.order import LEVELS, in_order_of_effect
from streamlod.core.train.keyframe.tables import AnchorTables, tables_of
from streamlod.core.train.optimise.schedule import dropout_keep, keyframe_rates, unlocked_level, view_order
from streamlod.core.train.pictures.views import Views

_LEAST_CONTRAST = 0.05  # share of the usual one: below it, pictures hold hardly more than noise


class KeyframeTrainer:
    """Optimises a field against one instant.

    Attributes:
        motion_cell: width of the cells that motion is measured in, in world units.

    Args:
        field: first anchors, from `core.train.keyframe.seeding`.
        views: the pictures.
        config: the whole configuration.
        backend: of the rasteriser.
        exposure: of the cameras, to begin with.
        motion_cell: see above.
        space: before the cameras, where nothing may stay; None where it is not known.
    """

    def __init__(
        self,
        field: Field,
        views: Views,
        config: TrainConfig,
        backend: Backend,
        exposure: Exposure,
        motion_cell: float,
        space: NearSpace | None = None,
    ) -> None:
        self._config, self._model = _for_pictures(config.keyframe, views), config.model
        device = field.feature.device
        self._generator = torch.Generator(device).manual_seed(config.seed)
        self._chances = torch.Generator().manual_seed(config.seed)  # what the host decides
        self._order = view_order(views.usable, self._chances)
        self._exposure = exposure.frozen()
        self._learned = LearnedField(field, self._exposure if config.model.exposure else None)
        self._views, self._space, self.motion_cell = views, space, motion_cell
        sizes = views.sizes() if self._config.half_size_until > 0 else [views]
        self._sizes = [ViewLoss(size, self._exposure, self._config, backend) for size in sizes]
        self._tables = self._made_tables()
        self._whole_loss = torch.zeros((), device=device)  # of the last step that drew all levels
        self._steps = 0

    @property
    def field(self) -> Field:
        """The anchors as they are now: averaged over the last steps once these have come, rounded as they are sent."""
        return self.precision.rounded(self._learned.settled)

    @property
    def precision(self) -> Precision:
        """How `field` is rounded."""
        return self._tables.precision or usual_precision(self._learned.settled)

    @property
    def exposure(self) -> Exposure:
        """Gains and offsets fitted so far."""
        return self._exposure.frozen()

    @property
    def progress(self) -> float:
        """How much of the run is done, in [0, 1]."""
        return min(self._steps / max(self._config.steps, 1), 1.0)

    @property
    def broken(self) -> int:
        """Gradient entries that were not finite and were taken as zero."""
        return self._learned.optimiser.broken

    def step(self) -> Tensor:
        """One view, one update; returns its loss, detached."""
        config, progress, number = self._config, self.progress, next(self._order)
        view_loss = self._view_loss(progress)
        unlocked = unlocked_level(self._learned.live.octree.levels, config, progress)
        highest = self._random_highest(unlocked)
        rows = self._drawn_rows(number, highest)
        splats = self._decode(number, rows, view_loss)
        raster, loss = self._drawn(splats, number, rows, view_loss)
        if highest == unlocked:
            loss.backward()  # type: ignore[no-untyped-call]
            self._tables.statistics.add(raster.probe, splats.opacities, rows)
            self._whole_loss = loss.detach()
        else:  # a coarse picture pulls hard wherever detail is missing, which says nothing about growing
            (self._cap_weight(loss.detach()) * loss).backward()  # type: ignore[no-untyped-call]
        self._learned.step(keyframe_rates(config, progress))
        self._exposure.centre()
        if progress >= config.average_from:
            self._learned.optimiser.average()
        self._steps += 1
        if self._steps % config.growth_interval == 0:
            self._refine(unlocked, grows=config.growth_from < progress < config.growth_until)
        if progress < config.growth_until <= self.progress and self._model.selection == "all":
            self._order_by_effect(view_loss)
        return loss.detach()

    def _view_loss(self, progress: float) -> ViewLoss:
        """The pictures of a step: from the smallest to the whole ones, each size for as many steps as the next."""
        until, last = self._config.half_size_until, len(self._sizes) - 1
        return self._sizes[int(progress / until * last) if progress < until else last]

    def _random_highest(self, unlocked: int) -> int:
        """The finest level of a step: mostly all that are `unlocked`, now and then fewer, for a coarser picture."""
        if self._chance() >= self._config.level_cap_share or unlocked == 0:
            return unlocked
        return int(torch.randint(0, unlocked, (), generator=self._chances))

    def _chance(self) -> float:
        return float(torch.rand((), generator=self._chances))

    def _drawn_rows(self, number: int, highest: int) -> Tensor | None:
        """Anchors of a step: all, those up to level `highest`, or those that the camera's distances call for."""
        if self._model.selection == "distance":
            return torch.nonzero(visible_levels(self._learned.live, self._views.centres[number], highest))[:, 0]
        return self._tables.up_to[highest]

    def _decode(self, number: int, rows: Tensor | None, view_loss: ViewLoss) -> Splats:
        """The Gaussians of the anchors `rows`, None for all, rounded once that has begun."""
        field = self._learned.live
        drawn = field if rows is None else field.with_rows(rows)
        if self.progress >= self._config.rounding_from:
            if self._tables.precision is None:
                precision = precision_within(field, view_loss, self._config.rounding_share, self._steps)
                self._tables = replace(self._tables, precision=precision)
            drawn = self.precision.rounded(drawn, rows)
        return drawn.decode(self._views.centres[number])

    def _drawn(self, splats: Splats, number: int, rows: Tensor | None, view_loss: ViewLoss) -> tuple[Raster, Tensor]:
        """The picture of `splats`, some of them left out, and its loss (equation 10 of the paper)."""
        level, support, price, hiding = self._tables.of_gaussians(rows)
        levels = self._learned.live.octree.levels
        kept = dropout_keep(level, levels, self._config, self.progress, self._generator, support)
        raster = view_loss.draw(replace(splats, opacities=splats.opacities * kept), number)
        if self._config.random_background and self._chance() < self._tables.backgrounds[number]:
            colour = torch.rand(3, generator=self._generator, device=level.device)
            raster = view_loss.over(raster, number, colour)
        penalty = view_loss.penalty(splats, raster, price, hiding)
        return raster, view_loss.loss(raster, number) + penalty

    def _cap_weight(self, loss: Tensor) -> Tensor | float:
        """The factor of `loss`, of a coarser picture: once levels have their order, it counts as much as the whole's.

        A fixed factor would be too large in dark scenes, where the loss of the whole picture becomes small.
        """
        if self.progress < self._config.growth_until:
            return self._config.level_cap_weight
        return (self._whole_loss / loss.clamp_min(1e-9)).clamp(max=1.0)

    def _refine(self, unlocked: int, *, grows: bool) -> None:
        """Add anchors up to the level `unlocked`, and remove some; where none `grows`, see what hides something now."""
        if not grows:
            self._tables = replace(self._tables, hiding=self._hiding())
            return
        config, settled = self._config, self._learned.settled
        astray = None if self._space is None else self._space.astray(settled, config.clearance)
        limits = unlocked, self._model.max_anchors
        refine(self._learned, self._tables.statistics, config, *limits, self._generator, astray)
        self._tables = self._made_tables()

    def _order_by_effect(self, view_loss: ViewLoss) -> None:
        """Put anchors on levels by what they are worth; those without which pictures look almost as they do go.

        Not where distances call for levels, as in the paper: these are those of the octree.
        """
        effects, rest = effects_and_rest(self._learned.settled, view_loss, self._config.effect_share, self._steps)
        self._learned.keep(rest)
        cell, levels = narrowest_cell(self.motion_cell), self._model.levels or LEVELS
        self._learned.regroup(in_order_of_effect(self._learned.live, effects[rest], cell, levels))
        self._tables = self._made_tables()

    def _made_tables(self) -> AnchorTables:
        return tables_of(self._learned.live, self._views, self._hiding(), by_support=self._config.by_support)

    def _hiding(self) -> Tensor:
        """[N,K] what the opacity of Gaussians that hang before views between cameras costs there."""
        field, config = self._learned.live, self._config
        if self._space is None or config.hiding_weight == 0:
            return torch.zeros_like(field.offset[..., 0])
        with torch.no_grad():
            splats = field.decode(self._views.centres[0])
        return config.hiding_weight * self._space.hidden(splats, config.clearance).view(len(field), -1)


def _for_pictures(config: KeyframeConfig, views: Views) -> KeyframeConfig:
    """What is weighed against losses and gradients, for pictures of less contrast, or larger, than is usual."""
    share, larger = 1.0, 1.0
    if config.usual_contrast > 0:
        share = min(max(views.contrast / config.usual_contrast, _LEAST_CONTRAST), 1.0)
    if config.usual_pixels > 0:
        larger = max(views.targets[0, ..., 0].numel() / config.usual_pixels, 1.0)
    return replace(
        config,
        opacity_weight=share * config.opacity_weight,
        growth_threshold=share / larger**0.25 * config.growth_threshold,
    )
