"""Training the first frame: an anchor model from nothing but points and pictures (paper section IV-A)."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from streamlod.core.render.backends import Backend
from streamlod.core.scene.octree import narrowest_cell
from streamlod.core.train.config import KeyframeConfig, TrainConfig
from streamlod.core.train.field.decode import Network, Splats
from streamlod.core.train.field.exposure import Exposure, neutral
from streamlod.core.train.field.field import Field, visible_levels
from streamlod.core.train.field.learned import LearnedField
from streamlod.core.train.field.rounding import Precision, usual_precision
from streamlod.core.train.growth.gradient import GrowthStatistics
from streamlod.core.train.growth.near_space import NearSpace
from streamlod.core.train.growth.refine import refine
from streamlod.core.train.keyframe.drawing import ViewLoss
from streamlod.core.train.keyframe.effect import anchor_effects, dispensable
from streamlod.core.train.keyframe.order import LEVELS, in_order_of_effect
from streamlod.core.train.keyframe.precision import sensitivity, signed_gradients, tuned_precision
from streamlod.core.train.keyframe.relative_error import RelativeErrors
from streamlod.core.train.keyframe.support import price_share, support, view_support
from streamlod.core.train.optimise.schedule import dropout_keep, keyframe_rates, unlocked_level, view_order
from streamlod.core.train.pictures.views import Views

_LEAST_CONTRAST = 0.05  # share of the usual one: below it, pictures hold hardly more than noise


class KeyframeTrainer:
    """Optimises a field against one instant.

    Args:
        field: first anchors, from `core.train.keyframe.seeding`.
        views: the pictures.
        config: the whole configuration.
        backend: of the rasteriser.
        exposure: of the cameras, to begin with; neutral by default.
        space: before the cameras, where nothing may stay; None where it is not known.
        motion_cell: width of the cells that motion is measured in, in world units; those of the field by default.
    """

    def __init__(
        self,
        field: Field,
        views: Views,
        config: TrainConfig,
        backend: Backend,
        exposure: Exposure | None = None,
        space: NearSpace | None = None,
        motion_cell: float | None = None,
    ) -> None:
        self._config, self._model = _at_contrast(config.keyframe, views.contrast), config.model
        device = field.feature.device
        self._generator = torch.Generator(device).manual_seed(config.seed)
        self._chances = torch.Generator().manual_seed(config.seed)  # what the host decides
        self._centres = [torch.from_numpy(camera.centre).float().to(device) for camera in views.cameras]
        self._order = view_order(views.usable, self._chances)
        self._exposure = neutral(len(views.cameras), device) if exposure is None else exposure.frozen()
        self._whole = views
        self._sizes = views.sizes() if self._config.half_size_until > 0 else [views]
        self._view_loss = ViewLoss(self._sizes[0], self._exposure, self._config, backend)
        self._learned = LearnedField(field, self._exposure if config.model.exposure else None)
        self._space = space
        self._begin_with_anchors(field)
        self._motion_cell = field.octree.motion_cell if motion_cell is None else motion_cell
        self._precision: Precision | None = None
        self._whole_loss = torch.zeros((), device=device)  # of the last step that drew all levels
        self._steps = 0

    @property
    def field(self) -> Field:
        """The anchors as they are now: averaged over the last steps once these have come, rounded as they are sent."""
        return self.precision.rounded(self._learned.settled)

    @property
    def precision(self) -> Precision:
        """How `field` is rounded."""
        field, measured = self._learned.settled, self._precision
        return usual_precision(field) if measured is None or len(measured.shift) != len(field) else measured

    @property
    def exposure(self) -> Exposure:
        """Gains and offsets fitted so far."""
        return self._exposure.frozen()

    @property
    def motion_cell(self) -> float:
        """Width of the cells that motion is measured in, in world units."""
        return self._motion_cell

    @property
    def progress(self) -> float:
        """How much of the run is done, in [0, 1]."""
        return min(self._steps / max(self._config.steps, 1), 1.0)

    @property
    def broken(self) -> int:
        """Gradient entries that were not finite and were taken as zero."""
        return self._learned.broken

    def step(self) -> Tensor:
        """One view, one update; returns its loss, detached."""
        config, progress = self._config, self.progress
        field = self._learned.live
        self._highest = unlocked_level(field.octree.levels, config, progress)
        self._view_loss = replace(self._view_loss, views=self._views_at(progress))
        number = next(self._order)
        cap = self._random_cap()
        rows = self._drawn_rows(field, number, self._highest if cap is None else cap)
        rounded = progress >= config.rounding_from
        if rounded and (self._precision is None or len(self._precision.shift) != len(field)):
            self._precision = self._measured_precision(field)
        splats = self._decode(field, number, rows, rounded=rounded)
        level, shared, prices = (_of_rows(values, rows) for values in self._of_gaussians)
        kept = dropout_keep(level, field.octree.levels, config, progress, self._generator, shared)
        opacities = splats.opacities * kept
        raster = self._view_loss.draw(replace(splats, opacities=opacities), number)
        if config.random_background and float(torch.rand((), generator=self._chances)) < self._agreement[number]:
            colour = torch.rand(3, generator=self._generator, device=field.level.device)
            raster = self._view_loss.over(raster, number, colour)
        price = self._view_loss.penalty(splats, raster, prices, _of_rows(self._hiding, rows))
        loss = self._view_loss.loss(raster, number) + price  # equation 10 of the paper
        (loss if cap is None else self._cap_weight(loss.detach()) * loss).backward()  # type: ignore[no-untyped-call]
        self._learned.step(keyframe_rates(config, progress))
        self._exposure.centre()
        if cap is None:  # a coarse picture pulls hard wherever detail is missing, which says nothing about growing
            self._statistics.add(raster.probe, splats.opacities, rows)
            self._whole_loss = loss.detach()
        self._steps += 1
        if progress >= config.average_from:
            self._learned.average()
        if self._steps % config.growth_interval == 0 and config.growth_from < progress < config.growth_until:
            limits = self._highest, self._model.max_anchors
            refine(self._learned, self._statistics, config, *limits, self._generator, self._astray())
            self._begin_with_anchors(self._learned.live)
        elif self._steps % config.growth_interval == 0:
            self._look_between(self._learned.live)
        if progress < config.growth_until <= self.progress:
            self._order_by_effect()
        return loss.detach()

    def _views_at(self, progress: float) -> Views:
        """The pictures of a step: from the smallest to the whole ones, each size for as many steps as the next."""
        until, smaller = self._config.half_size_until, len(self._sizes) - 1
        return self._sizes[int(progress / until * smaller)] if progress < until else self._whole

    def _astray(self) -> Tensor | None:
        """[N] anchors that are where the scene is not."""
        return None if self._space is None else self._space.astray(self._learned.settled, self._config.clearance)

    def _look_between(self, field: Field) -> None:
        """See which Gaussians hang before views between cameras, and what their opacity costs there, [N,K]."""
        self._hiding: Tensor = torch.zeros_like(field.offset[..., 0])
        if self._space is not None and self._config.hiding_weight > 0:
            with torch.no_grad():
                splats = field.decode(self._centres[0])
            hidden = self._space.hidden(splats, self._config.clearance)
            self._hiding = self._config.hiding_weight * hidden.view(len(field), -1)

    def _random_cap(self) -> int | None:
        """The finest level of a step that trains a coarser picture, or None for a step that trains the whole one."""
        share = self._config.level_cap_share
        if torch.rand((), generator=self._chances).item() >= share or self._highest == 0:
            return None
        return int(torch.randint(0, self._highest, (), generator=self._chances))

    def _cap_weight(self, loss: Tensor) -> Tensor | float:
        """The factor of `loss`, of a coarser picture: once levels have their order, it counts as much as the whole's.

        A fixed factor would be too large in dark scenes, where the loss of the whole picture becomes small.
        """
        if self.progress < self._config.growth_until:
            return self._config.level_cap_weight
        return (self._whole_loss / loss.clamp_min(1e-9)).clamp(max=1.0)

    def _drawn_rows(self, field: Field, number: int, highest: int) -> Tensor | None:
        """Anchors of a step: all, those up to level `highest`, or those that the camera's distances call for."""
        if self._model.selection == "distance":
            return torch.nonzero(visible_levels(field, self._centres[number], highest))[:, 0]
        return self._up_to[highest] if highest < len(self._up_to) else None

    def _decode(self, field: Field, number: int, rows: Tensor | None, *, rounded: bool) -> Splats:
        drawn = field if rows is None else field.with_rows(rows)
        if rounded:
            drawn = self.precision.rounded(drawn, rows)
        return drawn.decode(self._centres[number])

    def _measured_precision(self, field: Field) -> Precision:
        """Precision that costs as much of the squared error of every camera, on average, as configured."""
        if len(field) <= field.feature.shape[1]:  # too few rows to say how features go together
            return usual_precision(field)
        usable = self._whole.usable
        start = replace(field, network=Network(*(value.detach() for value in field.network.parameters())))

        def splats(number: int, leaves: tuple[Tensor, ...]) -> Splats:
            feature, offset, scaling = leaves
            return replace(start, feature=feature, offset=offset, scaling=scaling).decode(self._centres[number])

        def added(precision: Precision) -> float:
            return len(usable) * errors.added(_leaves(precision.rounded(start)))

        errors = RelativeErrors(self._view_loss, splats)
        found = sensitivity(signed_gradients(_leaves(start), errors.picture, usable, seed=self._steps))
        return tuned_precision(field, found, self._config.rounding_share * len(usable), added)

    def _order_by_effect(self) -> None:
        """Put anchors on levels by what they are worth; those without which pictures look almost as they do go.

        The paper's levels are those of the octree, as are distances that call for them.
        """
        share, field, usable = self._config.effect_share, self._learned.settled, self._whole.usable
        if self._model.selection == "distance":
            return

        def splats(number: int, present: Tensor) -> Splats:
            whole = field.decode(self._centres[number])
            return replace(whole, opacities=whole.opacities * present.repeat_interleave(field.slots))

        errors = RelativeErrors(self._view_loss, splats)
        effects = anchor_effects(len(field), errors.picture, usable, self._steps, field.level.device)
        if share > 0:
            kept = torch.nonzero(~dispensable(effects, share, errors.added))[:, 0]
            self._learned.keep(kept)
            effects = effects[kept]
        cell = narrowest_cell(self._motion_cell)
        self._learned.regroup(in_order_of_effect(self._learned.live, effects, cell, self._model.levels or LEVELS))
        self._begin_with_anchors(self._learned.live)

    def _begin_with_anchors(self, field: Field) -> None:
        """Go on with the anchors of `field`, some of which have just come, or others gone."""
        self._statistics = GrowthStatistics(len(field), field.slots, field.level.device)
        # looked up once, since the host waits for a GPU to find them
        self._up_to = [torch.nonzero(field.level <= highest)[:, 0] for highest in range(field.octree.levels - 1)]
        cameras = [self._whole.cameras[number] for number in self._whole.usable]
        supported = support(field.position, cameras) if self._config.by_support else torch.ones_like(field.extra_level)
        agreement = view_support(supported, field.position, cameras)
        self._agreement = dict(zip(self._whole.usable, agreement, strict=True))  # how often backgrounds are random
        self._look_between(field)
        values = field.level, supported, price_share(supported)
        self._of_gaussians: tuple[Tensor, ...] = tuple(
            value.repeat_interleave(field.slots).view(len(field), -1) for value in values
        )


def _leaves(field: Field) -> tuple[Tensor, Tensor, Tensor]:
    return field.feature, field.offset, field.scaling


def _of_rows(values: Tensor, rows: Tensor | None) -> Tensor:
    """[G] of `values` [N,K] of all Gaussians, those of the anchors `rows`; all by default."""
    return (values if rows is None else values[rows]).flatten()


def _at_contrast(config: KeyframeConfig, contrast: float) -> KeyframeConfig:
    """What is weighed against losses and gradients, for pictures in which these are smaller than usual."""
    if contrast >= config.usual_contrast:
        return config
    share = max(contrast / config.usual_contrast, _LEAST_CONTRAST)
    return replace(
        config, opacity_weight=share * config.opacity_weight, growth_threshold=share * config.growth_threshold
    )
