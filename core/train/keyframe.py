"""Training the first frame: an anchor model from nothing but points and pictures (paper section III-A)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from core.camera import Camera
from core.render.backends import Backend
from core.render.differentiable import rasterise
from core.render.raster import Raster
from core.train.config import TrainConfig
from core.train.decode import Network, Splats, decode
from core.train.exposure import Exposure, neutral
from core.train.field import Field, visible_levels
from core.train.growth import GrowthStatistics, earned_extra_level, grow
from core.train.heads import separate_heads
from core.train.levels import needed_levels
from core.train.losses import photometric_loss
from core.train.newcomers import strongest
from core.train.optimiser import RowAdam
from core.train.precision import USUAL, row_shifts, sensitivities
from core.train.rounding import Steps
from core.train.schedule import ViewOrder, dropout_keep, keyframe_rates, unlocked_level

_ROW_PARAMETERS = ("feature", "offset", "scaling")
_NETWORK_PARAMETERS = ("hidden_weight", "hidden_bias", "output_weight", "output_bias")
_OFFSET_SPREAD = 0.3
_JUDGES = 4  # views, evenly spread, that say whether a level carries anything


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Training pictures: cameras, targets [C,H,W,3] float32 in [0, 1], and which of them are there."""

    cameras: tuple[Camera, ...]
    targets: Tensor
    usable: list[int]

    def halved(self) -> Views:
        """The same pictures at half the width and height: each pixel is the mean of those it covers."""
        height, width = (max(size // 2, 1) for size in self.targets.shape[1:3])
        planes = functional.adaptive_avg_pool2d(self.targets.permute(0, 3, 1, 2), (height, width))
        cameras = tuple(camera.scaled(width, height) for camera in self.cameras)
        return Views(cameras, planes.permute(0, 2, 3, 1).contiguous(), self.usable)


class KeyframeTrainer:
    """Optimises a field against one instant.

    Args:
        field: first anchors, from `core.train.seeding`.
        views: the pictures.
        config: the whole configuration.
        backend: of the rasteriser.
    """

    def __init__(self, field: Field, views: Views, config: TrainConfig, backend: Backend) -> None:
        self._config = config.keyframe
        self._model = config.model
        self._whole = views
        self._views = views.halved() if self._config.half_size_until > 0 else views
        self._backend = backend
        device = field.feature.device
        self._generator = torch.Generator(device).manual_seed(config.seed)
        self._chances = torch.Generator().manual_seed(config.seed)  # what the host decides
        self._centres = [torch.from_numpy(camera.centre).float().to(device) for camera in views.cameras]
        self._background = torch.zeros(3, device=device)
        self._order = ViewOrder(views.usable, self._chances)
        self._exposure = neutral(len(views.cameras), device)
        leaves = {name: getattr(field, name).clone().requires_grad_() for name in _ROW_PARAMETERS}
        network = {name: getattr(field.network, name).clone().requires_grad_() for name in _NETWORK_PARAMETERS}
        if config.model.heads == "separate":
            joined = separate_heads(field.slots).to(device)
            network["output_weight"].register_hook(lambda gradient: gradient * joined)
        exposure = {"gain": self._exposure.gain, "exposure_offset": self._exposure.offset}
        if config.model.exposure:
            for value in exposure.values():
                value.requires_grad_()
        self._optimiser = RowAdam({**leaves, **network, **(exposure if config.model.exposure else {})})
        self._fixed = field
        self._statistics = GrowthStatistics(len(field), field.slots, device)
        self._highest = field.octree.levels - 1
        self._shifts = field.level[:0]
        self._average: dict[str, Tensor] = {}
        self._averaged = 0
        self._done = 0

    @property
    def field(self) -> Field:
        """The anchors as they are now: averaged over the last steps once these have come, rounded as they are sent."""
        field = self._current()
        feature, offset, scaling = Steps().rounded(field.feature, field.offset, field.scaling, self._precision())
        return replace(field, feature=feature, offset=offset, scaling=scaling)

    def _current(self) -> Field:
        """The anchors as they are now: detached, unrounded, averaged once there is an average."""
        parameters = {name: value.detach() for name, value in self._optimiser.parameters.items()}
        parameters |= self._average
        return replace(
            self._fixed,
            feature=parameters["feature"],
            offset=parameters["offset"],
            scaling=parameters["scaling"],
            network=_network_of(parameters),
        )

    @property
    def exposure(self) -> Exposure:
        """Gains and offsets fitted so far."""
        return self._exposure.frozen()

    @property
    def broken(self) -> int:
        """Gradient entries that were not finite and were taken as zero."""
        return self._optimiser.broken

    def step(self) -> Tensor:
        """One view, one update; returns its loss, detached."""
        config, progress = self._config, self._done / self._config.steps
        self._highest = unlocked_level(self._fixed.octree.levels, config, progress)
        if progress >= config.half_size_until:
            self._views = self._whole
        number = self._order.next()
        cap = self._random_cap()
        rows = self._drawn_rows(number, self._highest if cap is None else cap)
        if progress >= config.rounding_from and len(self._shifts) != len(self._fixed):
            self._shifts = self._measured_shifts()
        splats = self._decode(number, rows, rounded=progress >= config.rounding_from)
        level = (self._fixed.level if rows is None else self._fixed.level[rows]).repeat_interleave(self._fixed.slots)
        opacities = splats.opacities * dropout_keep(level, config, progress, self._generator)
        raster = self._draw(replace(splats, opacities=opacities), number)
        loss = self._loss(raster, splats, number)
        (loss if cap is None else config.level_cap_weight * loss).backward()  # type: ignore[no-untyped-call]
        rates = keyframe_rates(config, progress)
        rates |= dict.fromkeys(_NETWORK_PARAMETERS, rates["network"])
        rates |= dict.fromkeys(("gain", "exposure_offset"), rates["exposure"])
        self._optimiser.step(rates)
        if self._model.exposure:
            self._exposure.centre()
        if cap is None:  # a coarse picture pulls hard wherever detail is missing, which says nothing about growing
            self._count(raster, splats, rows)
        self._done += 1
        if progress >= config.average_from:
            self._add_to_average()
        if self._done % config.growth_interval == 0 and config.growth_from < progress < config.growth_until:
            self._adjust()
        if progress < config.growth_until <= self._done / config.steps:
            self._drop_idle_levels()
        return loss.detach()

    def _random_cap(self) -> int | None:
        """The finest level of a step that trains a coarser picture, or None for a step that trains the whole one."""
        if torch.rand((), generator=self._chances).item() >= self._config.level_cap_share or self._highest == 0:
            return None
        return int(torch.randint(0, self._highest, (), generator=self._chances))

    def _drawn_rows(self, number: int, highest: int) -> Tensor | None:
        """Anchors of a step: all, those up to level `highest`, or those that the camera's distances call for."""
        field = self._fixed
        if self._model.selection == "distance":
            return torch.nonzero(visible_levels(field, self._centres[number], highest))[:, 0]
        return None if highest == field.octree.levels - 1 else torch.nonzero(field.level <= highest)[:, 0]

    def _decode(self, number: int, rows: Tensor | None, *, rounded: bool) -> Splats:
        parameters = self._optimiser.parameters
        feature, offset, scaling = parameters["feature"], parameters["offset"], parameters["scaling"]
        position = self._fixed.position
        if rows is not None:
            feature, offset, scaling, position = feature[rows], offset[rows], scaling[rows], position[rows]
        if rounded:
            shift = self._precision() if rows is None else self._precision()[rows]
            feature, offset, scaling = Steps().rounded(feature, offset, scaling, shift)
        view = self._fixed.view(self._centres[number])
        return decode(feature, offset, scaling, position, _network_of(parameters), view)

    def _precision(self) -> Tensor:
        """[N] doublings of the finest steps that each anchor is rounded to."""
        if len(self._shifts) == len(self._fixed):
            return self._shifts
        return torch.full_like(self._fixed.level, USUAL)

    def _measured_shifts(self) -> Tensor:
        """Precision that costs as much of the squared error as configured."""
        parameters = self._optimiser.parameters
        network = Network(*(value.detach() for value in _network_of(parameters).parameters()))
        error = 0.0

        def draw(number: int, leaves: tuple[Tensor, ...]) -> Tensor:
            nonlocal error
            feature, offset, scaling = leaves
            view = self._fixed.view(self._centres[number])
            image = self._draw(decode(feature, offset, scaling, self._fixed.position, network, view), number).image
            with torch.no_grad():
                shown = self._exposure.apply(image, number) if self._model.exposure else image
                error += float((shown - self._views.targets[number]).square().sum())
            return image

        leaves = tuple(parameters[name] for name in _ROW_PARAMETERS)
        feature, offset, scaling = sensitivities(leaves, draw, self._views.usable, seed=self._done)
        return row_shifts((feature, offset, scaling), Steps(), self._config.rounding_share * error)

    def _draw(self, splats: Splats, number: int) -> Raster:
        return rasterise(*splats.astuple(), self._views.cameras[number], self._background, backend=self._backend)

    def _loss(self, raster: Raster, splats: Splats, number: int) -> Tensor:
        """Equation 5 of the paper, with Scaffold-GS's regulariser of the volume (method notes 8.A row 39)."""
        image = self._exposure.apply(raster.image, number) if self._model.exposure else raster.image
        loss = photometric_loss(image, self._views.targets[number], self._config.dssim_weight)
        if self._config.scale_weight:
            drawn = splats.opacities.detach() > 0
            loss = loss + self._config.scale_weight * splats.scales.prod(dim=1)[drawn].sum() / drawn.sum().clamp_min(1)
        return loss

    def _drop_idle_levels(self) -> None:
        """Give up fine levels that carry nothing, while there are steps left to settle; the paper keeps all."""
        if self._model.selection == "distance" or self._model.levels is not None:
            return
        octree, level = self._fixed.octree, self._fixed.level
        judges = self._views.usable[:: max(1, len(self._views.usable) // _JUDGES)]

        @torch.no_grad()
        def loss(highest: int) -> float:
            rows = torch.nonzero(level <= highest)[:, 0]
            losses = []
            for number in judges:
                splats = self._decode(number, rows, rounded=False)
                losses.append(float(self._loss(self._draw(splats, number), splats, number)))
            return sum(losses) / len(losses)

        needed = needed_levels(octree.levels, loss)
        if needed == octree.levels:
            return
        rows = torch.nonzero(level < needed)[:, 0]
        nothing = {name: self._optimiser.parameters[name].detach()[:0] for name in _ROW_PARAMETERS}
        self._optimiser.replace_rows(rows, nothing)
        self._fixed = replace(
            self._fixed,
            octree=replace(octree, levels=needed),
            level=level[rows],
            voxel=self._fixed.voxel[rows],
            extra_level=self._fixed.extra_level[rows],
            position=self._fixed.position[rows],
        )
        self._statistics = GrowthStatistics(len(rows), self._fixed.slots, level.device)

    def _count(self, raster: Raster, splats: Splats, rows: Tensor | None) -> None:
        slots = self._fixed.slots
        visible = raster.probe.visible
        norms = raster.probe.gradients.norm(dim=1)
        opacity = splats.opacities.detach().clamp_min(0).reshape(-1, slots).sum(dim=1)
        anchors = torch.arange(len(self._fixed), device=visible.device) if rows is None else rows
        gaussians = anchors[visible // slots] * slots + visible % slots
        self._statistics.add(gaussians, norms, anchors, opacity)

    def _add_to_average(self) -> None:
        """Mean of the parameters over the last steps: steadier than any one of them (Polyak averaging)."""
        self._averaged += 1
        for name, value in self._optimiser.parameters.items():
            mean = self._average.setdefault(name, value.detach().clone())
            mean.lerp_(value.detach(), 1 / self._averaged)

    def _adjust(self) -> None:
        """Grow, prune, and start counting anew."""
        field, config = self._current(), self._config
        gradient = self._statistics.mean_gradient()
        extra = earned_extra_level(field, gradient, config).float() * config.extra_level_gain
        new = grow(field, gradient, config.growth_threshold, self._highest)
        room = max(self._model.max_anchors - len(field), 0)
        new = strongest(new, gradient.reshape(len(field), -1), room)
        kept = torch.nonzero(~self._statistics.faint(config.prune_opacity))[:, 0]
        device = field.feature.device
        level, voxel = torch.from_numpy(new.level).to(device), torch.from_numpy(new.voxel).to(device)
        parent = torch.from_numpy(new.parent).to(device)
        cells = field.octree.root_cell / 2.0 ** level.double()
        position = (torch.from_numpy(field.octree.origin).to(device) + voxel * cells[:, None]).float()
        self._optimiser.replace_rows(
            kept,
            {
                "feature": field.feature[parent],
                "offset": _OFFSET_SPREAD
                * torch.randn(len(new), field.slots, 3, generator=self._generator, device=device),
                "scaling": cells.log().float()[:, None].repeat(1, 6),
            },
        )
        self._fixed = replace(
            self._fixed,
            level=torch.cat([field.level[kept], level]),
            voxel=torch.cat([field.voxel[kept], voxel]),
            extra_level=torch.cat([(field.extra_level + extra)[kept], torch.zeros(len(new), device=device)]),
            position=torch.cat([field.position[kept], position]),
        )
        self._statistics = GrowthStatistics(len(self._fixed), field.slots, field.feature.device)


def _network_of(parameters: dict[str, Tensor]) -> Network:
    return Network(*(parameters[name] for name in _NETWORK_PARAMETERS))
