"""The steps of one later frame in the memory of a `TrainingStep`: what each is told, and the numbers that come out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from streamlod.core.render.warp.listing import list_gaussians
from streamlod.core.scene.anchors import LATENTS
from streamlod.core.train.engine.warp.frame import begin
from streamlod.core.train.engine.warp.room import view_of
from streamlod.core.train.engine.warp.step import TrainingStep

_BETA2 = 0.999  # of Adam, as in `core.train.optimise.adam`


@dataclass(frozen=True, slots=True)
class StepSettings:
    """What a step goes by.

    Attributes:
        latent_rate, position_rate: Adam's, in steps of the numbers.
        memory: beta_1, the share of the mean gradient that each step keeps.
        price: of a bit, in units of the loss. dssim_weight: share of D-SSIM in the loss.
    """

    latent_rate: float
    position_rate: float
    memory: float
    price: float
    dssim_weight: float


def told(number: int, settings: StepSettings, counted: int = 0) -> tuple[float, ...]:
    """What the step is told that comes after `number` others (`kernels.layout`).

    Args:
        counted: steps in the mean with this one, 0 if it does not count into it.
    """
    first = 1 - settings.memory ** (number + 1)
    rates = (settings.latent_rate, settings.position_rate)
    return (
        *(rate / first for rate in rates),
        1 / (1 - _BETA2 ** (number + 1)),
        1 - settings.memory,
        1 - _BETA2,
        1 / counted if counted else 0.0,
        settings.price,
        settings.dssim_weight,
        0.0,
    )


@dataclass(frozen=True, slots=True, eq=False)
class FrameNumbers:
    """Numbers of n anchors: latent [n,24], position [n,3]."""

    latent: Tensor
    position: Tensor


class FrameSteps:
    """Steps of one frame, whose anchors, Gaussians and pictures `step` holds (`core.train.engine.warp.frame`).

    Args:
        known: cameras whose pictures of the state before were given; all tiles of the others are drawn.
        latent: [n,24], position: [n,3] where training begins.
    """

    def __init__(self, step: TrainingStep, known: Sequence[int], latent: Tensor, position: Tensor) -> None:
        self._step, self._count = step, len(latent)
        self._taken = self._counted = 0
        begin(step.room, torch.zeros_like(latent), torch.zeros_like(position))
        dirty = view_of(step.room.sight.dirty)
        dirty[[number not in known for number in range(len(dirty))]] = 1
        for number in known:
            self._mark(number)
        begin(step.room, latent, position)

    def take(self, cameras: Sequence[int], settings: StepSettings, *, counts: bool) -> Tensor:
        """One step on the pictures of `cameras` [V]; its loss [], on the device.

        Args:
            counts: into the mean of the last steps.
        """
        self._counted += counts
        numbers = told(self._taken, settings, self._counted if counts else 0)
        self._step.run(self._taken, numbers, cameras)
        self._taken += 1
        return view_of(self._step.room.trained.losses)[self._taken - 1].clone()

    def numbers(self) -> FrameNumbers:
        """What the last step left; where steps counted into the mean, the mean."""
        room = self._step.room
        flat = view_of(room.trained.mean if self._counted else room.trained.values)
        own = flat.view(-1, LATENTS + 3)[: self._count].clone()
        return FrameNumbers(own[:, :LATENTS], own[:, LATENTS:])

    def _mark(self, number: int) -> None:
        """Make tiles dirty that anchors reach at the numbers that they have: the known picture shows them there."""
        step, room = self._step, self._step.room
        view_of(room.sight.chosen).fill_(number)
        step.decode()
        seen = (room.sight.chosen, room.sight.cameras, room.sight.grid, room.sight.dirty)
        list_gaussians(room.moving, room.moving_count, room.cloud, *seen, room.device)
        view_of(room.trained.totals).zero_()
