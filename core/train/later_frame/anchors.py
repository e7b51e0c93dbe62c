"""The anchors that a later frame trains, as they will be sent.

Those that are there already are changed by residuals (paper section IV-C); of new ones all numbers are sent.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool, Int32
from streamlod.core.scene.anchors import LATENTS
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.convert import levels_of
from streamlod.core.train.field.field import Field
from streamlod.core.train.field.rounding import dead_zone
from streamlod.core.train.later_frame.added_anchors import MAX_STEPS, AddedAnchors
from streamlod.core.train.later_frame.apply import UnitChange, applied
from streamlod.core.train.later_frame.state import State
from streamlod.core.train.later_frame.update import IntegerUpdate
from streamlod.core.train.optimise.adam import RowAdam
from streamlod.core.train.optimise.rate import residual_bits


class TrainedAnchors:
    """Anchors `rows` [n] of a state in training.

    Attributes:
        base: they before the frame. unit: what one step of their numbers changes.
        steps_a_pixel: [n,1] position steps in which each goes a pixel: positions are trained in pixels, and known
            to all others in steps.
        added: those that the frame adds; None before it does.

    Args:
        memory: Adam's beta_1.
    """

    def __init__(
        self,
        state: State,
        rows: Tensor,
        steps_a_pixel: Tensor,
        memory: float,
    ) -> None:
        scene, field = state.scene, state.field
        device = field.feature.device
        self.base, self._scene = field.with_rows(rows), scene
        steps = (scene.weights.feature_decoder, scene.weights.offset_decoder, scene.header.position_steps)
        feature, offset, by_level = (torch.from_numpy(part).to(device) for part in steps)
        self.unit = UnitChange(feature, offset, by_level[self.base.level][:, None])
        self.steps_a_pixel = steps_a_pixel
        self._median_steps_a_pixel = float(steps_a_pixel.median())  # asked of the device once
        widths = {"latent": LATENTS, "position": 3}
        leaves = {name: torch.zeros(len(rows), width, device=device) for name, width in widths.items()}
        self.optimiser = RowAdam({name: value.requires_grad_() for name, value in leaves.items()}, memory)
        self.added: AddedAnchors | None = None
        self._broken_elsewhere = 0

    def __len__(self) -> int:
        return len(self.base)

    @property
    def moves(self) -> Tensor:
        """[n,3] how far each anchor goes in steps."""
        return self.optimiser.parameters["position"] * self.steps_a_pixel

    def bits(self, moves: Tensor) -> Tensor:
        """[] that the residuals of all n would take; `moves` as above."""
        return residual_bits(self.optimiser.parameters["latent"], moves)

    @torch.no_grad()
    def by_residuals(self) -> Field:
        """All n as they are now, without gradients."""
        return applied(self.base, self.optimiser.parameters["latent"], self.moves, self.unit)

    def field(self, moves: Tensor | None = None) -> Field:
        """As they will be sent: those that residuals change, and behind them those that are added.

        Args:
            moves: as above, where they are at hand.
        """
        moves = self.moves if moves is None else moves
        changed = applied(self.base, self.optimiser.parameters["latent"], moves, self.unit)
        return changed if self.added is None else self.added.behind(changed)

    def starting_at(self, position: Tensor) -> Field:
        """All n if they began `position` [n,3] steps from where they were."""
        return applied(self.base, self.optimiser.parameters["latent"].detach(), position, self.unit)

    def begin_at(self, position: Tensor) -> None:
        """Let their positions begin there."""
        with torch.no_grad():
            self.optimiser.parameters["position"].copy_(position / self.steps_a_pixel)

    def add(self, new: dict[str, Tensor]) -> None:
        """Train `new` anchors too from now on, the seven arrays of a field; once a frame."""
        if len(new["level"]):
            self.added = AddedAnchors(new, self.base, self._scene, self.optimiser)

    def rates(self, config: PredictConfig, decay: float) -> dict[str, float]:
        """How fast each parameter learns; rates have fallen to the share `decay`."""
        rates = {"latent": config.latent_rate, "position": config.position_rate}
        steps = config.position_rate * self._median_steps_a_pixel
        added = {} if self.added is None else self.added.rates(steps, decay)
        return {name: rate * decay for name, rate in rates.items()} | added

    def step(self, config: PredictConfig, decay: float) -> None:
        """Apply the gradients; rates have fallen to the share `decay`."""
        self.optimiser.step(self.rates(config, decay))

    @torch.no_grad()
    def adopt(self, latent: Tensor, position: Tensor, added: Tensor, broken: int) -> None:
        """Take over what was trained elsewhere.

        Args:
            latent: [n,24]. position: [n,3] in pixels.
            added: [m,F+3K+9], see `AddedAnchors.numbers`; [0,F+3K+9] where they came after the last step.
            broken: gradient entries that were not finite.
        """
        self.optimiser.parameters["latent"].copy_(latent)
        self.optimiser.parameters["position"].copy_(position)
        if self.added is not None and len(added):
            self.added.adopt(added)
        self._broken_elsewhere = broken

    @torch.no_grad()
    def settle(self) -> None:
        """All numbers become their means over the steps that were counted, if any were."""
        for name, mean in self.optimiser.mean.items():
            self.optimiser.parameters[name].copy_(mean)

    def update(self, shown: Bool, steps: int, loss: float) -> IntegerUpdate:
        """All that is sent, as integers.

        Args:
            shown: for each row of `field`; the others are removed, or not added.
            steps, loss: of the training.
        """
        latent, position = map(_finite_integers, (self.optimiser.parameters["latent"], self.moves))
        added = None
        if self.added is not None:
            new = np.flatnonzero(shown[len(self) :])
            chosen = self.field().with_rows(torch.from_numpy(new + len(self)).to(self.base.feature.device)).to("cpu")
            added = levels_of(chosen, self.added.moved[new], self._scene.header)
        return IntegerUpdate(
            latent,
            position,
            ~shown[: len(self)],
            added,
            steps,
            loss,
            self.optimiser.broken + self._broken_elsewhere,
        )


def _finite_integers(values: Tensor) -> Int32:
    """Integers as training saw them; what is not finite stays at its last good state, zero."""
    rounded = dead_zone(torch.nan_to_num(values.detach(), 0.0, 0.0, 0.0)).clamp(-MAX_STEPS, MAX_STEPS)
    return rounded.to(torch.int32).cpu().numpy()
