"""The engine of later frames whose training steps are recorded once and replayed (`core.train.later_frame.engine`)."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import torch
from torch import Tensor

from streamlod.core.render.raster import Probe, Raster
from streamlod.core.train.engine.warp.frame import load_anchors, load_cameras, load_pictures, load_still, load_targets
from streamlod.core.train.engine.warp.frame_steps import FrameSteps, StepSettings, mark_reached
from streamlod.core.train.engine.warp.room import Capacity, view_of
from streamlod.core.train.engine.warp.rooms import StepRooms
from streamlod.core.train.engine.warp.splats import drawn_splats
from streamlod.core.train.engine.warp.step import TrainingStep
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.later_frame.comparison import Comparison
from streamlod.core.train.later_frame.engine import EngineMaker, FrameTask
from streamlod.core.train.later_frame.steps import most_steps

_LOG = logging.getLogger(__name__)


def warp_engine(device: str) -> EngineMaker:
    """Engines that compute on `device`, one frame after the other in the same memory."""
    rooms = StepRooms(device)
    return lambda task: WarpEngine(task, rooms)


class WarpEngine:
    """As `FrameEngine`; all cameras are made ready when the first one is asked for."""

    def __init__(self, task: FrameTask, rooms: StepRooms) -> None:
        self._task, self._rooms = task, rooms
        self._reached: list[bool] | None = None
        self._steps: FrameSteps | None = None
        self._has_added = False
        self._taken: Any = None  # event after the step before
        self._is_half = task.seen.coarse is not task.seen.pictures

    def plan(self, number: int) -> bool:
        """As `FrameEngine.plan`."""
        if self._reached is None:
            self._reached = self._loaded()
        return self._reached[number]

    def enlarge(self) -> None:
        """As `FrameEngine.enlarge`."""
        self._is_half = False

    def step(self, number: int, decay: float, *, counts: bool) -> tuple[Tensor, Raster]:
        """As `FrameEngine.step`; the probe of the raster has no gradients."""
        task, step = self._task, self._current
        if self._steps is None:
            trained = task.anchors.optimiser.parameters
            self._steps = FrameSteps(step.room, trained["latent"].detach(), trained["position"].detach())
        if task.anchors.added is not None and not self._has_added:
            new = task.anchors.added
            self._steps.add(new.node, new.numbers, new.widths)
            self._has_added = True
        loss = self._steps.take(step, (number,), self._settings(decay), counts=counts)
        image, light = (view_of(part)[0].clone() for part in (step.room.drawn.image, step.room.drawn.light))
        self._keep_pace(loss.device)
        return loss, Raster(image, light, Probe(torch.empty(0, dtype=torch.int64)))

    def finish(self) -> None:
        """As `FrameEngine.finish`."""
        if self._steps is None:
            return
        broken = int(view_of(self._whole.room.trained.broken)[0])
        self._task.anchors.adopt(*self._steps.numbers(), broken)
        if self._rooms.overflow:
            _LOG.warning("some tiles lacked Gaussians in training, which had no room; the next frame has more")

    def draw_two(self, number: int, first: Splats, second: Splats) -> tuple[Tensor, Tensor]:
        """As `FrameEngine.draw_two`."""
        room = self._current.room
        return drawn_splats(room, number, first), drawn_splats(room, number, second)

    def target(self, number: int) -> Tensor:
        """As `FrameEngine.target`."""
        return view_of(self._current.room.filmed.target)[number]

    @torch.no_grad()
    def show(self, number: int, splats: Splats) -> Tensor:
        """As `FrameEngine.show`."""
        return drawn_splats(self._whole.room, number, splats)

    @property
    def _whole(self) -> TrainingStep:
        assert self._rooms.whole is not None, "a camera is planned first"
        return self._rooms.whole

    @property
    def _current(self) -> TrainingStep:
        """Steps of the size that is trained now."""
        return self._rooms.half if self._is_half and self._rooms.half is not None else self._whole

    def _keep_pace(self, device: torch.device) -> None:
        """Wait for the step before this one: a frame's pace goes by the clock, and asking for a step takes no time."""
        if device.type == "cpu":
            return
        before, self._taken = self._taken, torch.get_device_module(device).current_stream().record_event()
        if before is not None:
            before.synchronize()

    def _settings(self, decay: float) -> StepSettings:
        config, anchors = self._task.config, self._task.anchors
        numbers = self._task.seen.pictures.views.targets[0].numel()
        rates = anchors.rates(config, decay)
        feature, offset, scaling, place = (
            rates.get(f"new_{name}", 0.0) for name in ("feature", "offset", "scaling", "position")
        )
        new = feature, offset, scaling, place
        price = config.rate_weight / numbers
        return StepSettings(rates["latent"], rates["position"], config.memory, price, config.dssim_weight, new)

    def _loaded(self) -> list[bool]:
        """Whether the anchors in training reach the picture of each camera, once all is in memory."""
        seen, still = self._task.seen, self._task.still_splats()
        height, width = seen.coarse.views.targets.shape[1:3]
        half = (width, height) if self._is_half else None
        need = self._need(max(map(len, still)))
        self._rooms.provide(need, half)
        while True:  # what lacks room is counted too, so that this ends after the second time
            reached = self._load(self._whole, seen.pictures, still)
            if self._rooms.half is not None:
                self._load(self._rooms.half, seen.coarse, still)
                self._allow_for_size(self._rooms.half, seen.coarse)
            if not self._rooms.provide(self._rooms.counted(need), half):
                return reached

    def _need(self, still: int) -> Capacity:
        task, views, field = self._task, self._task.seen.pictures.views, self._task.anchors.base
        alive = task.seen.state.scene.anchor_count
        return Capacity(
            views=1,
            cameras=len(views.cameras),
            width=views.targets.shape[2],
            height=views.targets.shape[1],
            anchors=len(field),
            added=max((part.most_added(alive) for part in task.seen.config.parts), default=0),
            slots=field.slots,
            features=field.feature.shape[1],
            still=still,
            moving_pairs=0,
            still_pairs=0,
            steps=most_steps(task.config, len(views.cameras)),
            sees_views=field.view_dependent,
        )

    def _load(self, step: TrainingStep, pictures: Comparison, still: list[Splats]) -> list[bool]:
        """Whether anchors reach the picture of each camera."""
        room, anchors, config = step.room, self._task.anchors, self._task.config
        unit, shown = anchors.unit, pictures.known.shown
        load_cameras(room, pictures.views.cameras, self._task.exposure)
        units = (unit.feature, unit.offset, unit.position[:, 0], anchors.steps_a_pixel[:, 0])
        load_anchors(room, anchors.base, *units)
        load_still(room, still if anchors.base.view_dependent else still[:1])
        weights = 1 + config.changed_weight * pictures.masks.float()
        load_pictures(room, pictures.views.targets, shown, weights)
        mark_reached(step, len(anchors))
        dirty = view_of(room.sight.dirty)
        reached = dirty.any(dim=1).tolist()
        changed = [pictures.changed_tiles(number).ravel() for number in range(len(dirty))]
        dirty |= torch.from_numpy(np.stack(changed)).to(dirty)
        dirty[shown[:, 0, 0, 0].isnan()] = 1
        return [bool(found) for found in reached]

    @torch.no_grad()
    def _allow_for_size(self, step: TrainingStep, pictures: Comparison) -> None:
        """Ask only for what has changed, as `PlannedView.allowing_for_size`."""
        targets, base = pictures.views.targets.clone(), self._task.anchors.base
        for number, shown in enumerate(pictures.known.shown):
            if not bool(shown[0, 0, 0].isnan()):
                targets[number] += drawn_splats(step.room, number, self._task.filmed(base, number)) - shown
        load_targets(step.room, targets)
