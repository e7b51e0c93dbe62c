"""The usual engine of later frames: torch's autograd over the rasteriser of the device."""

from __future__ import annotations

import torch
from torch import Tensor

from streamlod.core.render.backends import Backend
from streamlod.core.render.raster import Raster
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.later_frame.autograd.planned import PlannedView, planned_view
from streamlod.core.train.later_frame.comparison import Comparison
from streamlod.core.train.later_frame.engine import EngineMaker, FrameTask
from streamlod.core.train.loss.photometric import photometric_loss


def autograd_engine(backend: Backend) -> EngineMaker:
    """Engines that draw with `backend`."""
    return lambda task: AutogradEngine(task, backend)


class AutogradEngine:
    """As `FrameEngine`; pictures are planned one by one, at half the size when they are first asked for."""

    def __init__(self, task: FrameTask, backend: Backend) -> None:
        self._task, self._backend = task, backend
        self._static = [task.exposure.before(splats, number) for number, splats in enumerate(task.still_splats())]
        self._whole: dict[int, PlannedView] = {}
        self._half: dict[int, PlannedView] | None = {} if task.seen.coarse is not task.seen.pictures else None

    def plan(self, number: int) -> bool:
        """As `FrameEngine.plan`."""
        self._whole[number] = self._plan(self._task.seen.pictures, number)
        return not self._whole[number].cache.is_empty

    def enlarge(self) -> None:
        """As `FrameEngine.enlarge`."""
        self._half = None

    def step(self, number: int, decay: float, *, counts: bool) -> tuple[Tensor, Raster]:
        """As `FrameEngine.step`."""
        task, view = self._task, self._planned(number)
        config, anchors = task.config, task.anchors
        moves = anchors.moves
        raster = view.cache.render(task.filmed(anchors.field(moves), number))
        loss = photometric_loss(raster.image, view.target, config.dssim_weight, view.cache.region, view.weights)
        if config.rate_weight:
            loss = loss + config.rate_weight * anchors.bits(moves) / self._whole[number].target.numel()
        loss.backward()  # type: ignore[no-untyped-call]
        anchors.step(config, decay)
        if counts:
            anchors.optimiser.average()
        return loss.detach(), raster

    def finish(self) -> None:
        """As `FrameEngine.finish`."""
        self._task.anchors.settle()

    def draw_two(self, number: int, first: Splats, second: Splats) -> tuple[Tensor, Tensor]:
        """As `FrameEngine.draw_two`."""
        one, other = self._planned(number).cache.render_two(first, second)
        return one.image, other.image

    def target(self, number: int) -> Tensor:
        """As `FrameEngine.target`."""
        return self._planned(number).target

    @torch.no_grad()
    def show(self, number: int, splats: Splats) -> Tensor:
        """As `FrameEngine.show`."""
        return self._whole[number].cache.render_exactly(splats).image

    def _planned(self, number: int) -> PlannedView:
        """Camera `number` at the size that is trained now."""
        if self._half is None:
            return self._whole[number]
        if number not in self._half:
            view = self._plan(self._task.seen.coarse, number)
            self._half[number] = view.allowing_for_size(self._task.filmed(self._task.anchors.base, number))
        return self._half[number]

    @torch.no_grad()
    def _plan(self, pictures: Comparison, number: int) -> PlannedView:
        task, static = self._task, self._static[number]
        trained, background = task.filmed(task.anchors.field(), number), task.exposure.offset[number]
        weight = task.config.changed_weight
        return planned_view(pictures, number, trained, static, background, self._backend, weight)
