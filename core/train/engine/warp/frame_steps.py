"""The steps of one later frame: what each is told, and the numbers that come out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from streamlod.core.render.warp.listing import list_gaussians
from streamlod.core.scene.anchors import LATENTS
from streamlod.core.train.engine.warp.frame import add_anchors, begin
from streamlod.core.train.engine.warp.room import StepRoom, view_of
from streamlod.core.train.engine.warp.step import TrainingStep

_BETA2 = 0.999  # of Adam, as in `core.train.optimise.adam`


@dataclass(frozen=True, slots=True)
class StepSettings:
    """What a step goes by.

    Attributes:
        latent_rate: Adam's, in steps of the numbers. position_rate: likewise, in pixels.
        memory: beta_1, the share of the mean gradient that each step keeps.
        price: of a bit, in units of the loss. dssim_weight: share of D-SSIM in the loss.
        added_rates: of features, offsets, scalings and places of new anchors, in their steps.
    """

    latent_rate: float
    position_rate: float
    memory: float
    price: float
    dssim_weight: float
    added_rates: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


def told(number: int, settings: StepSettings, counted: int = 0, joined: int = 0) -> tuple[float, ...]:
    """What the step is told that comes after `number` others (`kernels.layout`).

    Args:
        counted: steps in the mean with this one, 0 if it does not count into it.
        joined: steps that had been taken before anchors were added.
    """
    steps, since = number + 1, number + 1 - joined
    first, first_added = (1 - settings.memory**taken for taken in (steps, since))
    return (
        *(rate / first for rate in (settings.latent_rate, settings.position_rate)),
        1 / (1 - _BETA2**steps),
        1 - settings.memory,
        1 - _BETA2,
        1 / counted if counted else 0.0,
        settings.price,
        settings.dssim_weight,
        *(rate / first_added for rate in settings.added_rates),
        1 / (1 - _BETA2**since),
        0.0,
    )


class FrameSteps:
    """Steps of one frame, whose anchors, Gaussians and pictures lie in memory (`core.train.engine.warp.frame`).

    Args:
        room: where the numbers are trained.
        latent: [n,24], position: [n,3] in pixels, where training begins.
    """

    def __init__(self, room: StepRoom, latent: Tensor, position: Tensor) -> None:
        self._room, self._count = room, len(latent)
        self._taken = self._counted = self._joined = self._added = 0
        begin(room, latent, position)

    def take(self, step: TrainingStep, cameras: Sequence[int], settings: StepSettings, *, counts: bool) -> Tensor:
        """One step on the pictures of `cameras` [V]; its loss [], on the device.

        Args:
            step: in the memory of these numbers. counts: into the mean of the last steps.
        """
        self._counted += counts
        numbers = told(self._taken, settings, self._counted if counts else 0, self._joined)
        step.run(self._taken, numbers, cameras)
        self._taken += 1
        return view_of(self._room.trained.losses)[self._taken - 1].clone()

    def add(self, node: Tensor, values: Tensor, width: Tensor) -> None:
        """Train m more anchors from now on, as `frame.add_anchors`; once. The mean begins anew."""
        add_anchors(self._room, node, values, width)
        self._joined, self._added, self._counted = self._taken, len(node), 0

    def numbers(self) -> tuple[Tensor, Tensor, Tensor]:
        """Latents [n,24], positions [n,3] in pixels and numbers of m added anchors [m,F+3K+9].

        They are what the last step left; where steps counted into the mean, the mean.
        """
        old, new = self._room.trained, self._room.trained_added
        flat, added = (old.mean, new.mean) if self._counted else (old.values, new.values)
        own = view_of(flat).view(-1, LATENTS + 3)[: self._count].clone()
        return own[:, :LATENTS], own[:, LATENTS:], view_of(added)[: self._added].clone()


def mark_reached(step: TrainingStep, anchors: int) -> None:
    """Let steps draw the tiles of all cameras that the anchors, `anchors` of them, reach as they were before."""
    room = step.room
    begin(room, torch.zeros(anchors, LATENTS), torch.zeros(anchors, 3))
    for number in range(room.capacity.cameras):
        view_of(room.sight.chosen).fill_(number)
        step.decode()
        seen = (room.sight.chosen, room.sight.cameras, room.sight.grid, room.sight.dirty)
        list_gaussians(room.moving, room.moving_count, room.cloud, *seen, room.device)
    view_of(room.trained.totals).zero_()
