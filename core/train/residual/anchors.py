"""The anchors that a later frame trains, as they will be sent.

Most are changed by residuals (paper section IV-C). Of some all numbers are sent: of new ones, and of *rewritten* ones,
which take the place of an anchor that was there (`core.train.residual.rewriting`).
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool, Float32, Int32, Int64
from streamlod.core.scene.anchors import LATENTS
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.field import Field
from streamlod.core.train.field.rounding import dead_zone
from streamlod.core.train.growth.new_anchors import added_levels
from streamlod.core.train.optimise.mean import MeanOfSteps
from streamlod.core.train.optimise.optimisers import Optimiser
from streamlod.core.train.optimise.rate import residual_bits
from streamlod.core.train.residual.added_anchors import MAX_STEPS, AddedAnchors
from streamlod.core.train.residual.apply import ByResiduals, UnitChange
from streamlod.core.train.residual.groups import Groups, neighbourhoods
from streamlod.core.train.residual.rewriting import values_of
from streamlod.core.train.residual.state import State
from streamlod.core.train.residual.update import IntegerUpdate


class TrainedAnchors:
    """Anchors `rows` [n] of a state in training.

    Args:
        optimiser: of all their numbers.
        group_cells: width of the neighbourhoods that also move as one, in motion cells (`Octree`); 0 for none.
    """

    def __init__(self, state: State, rows: Tensor, optimiser: Optimiser, group_cells: float) -> None:
        scene, field = state.scene, state.field
        device = field.feature.device
        base = field.with_rows(rows)
        self._scene = scene
        steps = (scene.weights.feature_decoder, scene.weights.offset_decoder, scene.header.position_steps)
        feature, offset, by_level = (torch.from_numpy(part).to(device) for part in steps)
        self._all = self._kept = ByResiduals(None, base, UnitChange(feature, offset, by_level[base.level][:, None]))
        start = torch.zeros(len(field), LATENTS + 3, device=device) if state.start is None else state.start
        begin = {"latent": start[rows, :LATENTS], "position": start[rows, LATENTS:]}
        self._groups: Groups | None = None
        if group_cells > 0:
            self._groups = neighbourhoods(base.position, group_cells * field.octree.motion_cell)
            begin |= self._groups.at_rest()
        leaves = {name: value.clone().requires_grad_() for name, value in begin.items()}
        self.optimiser = optimiser.start(leaves)
        self._mean = MeanOfSteps()
        self._rewritten = torch.arange(0, device=device)
        self._whole: AddedAnchors | None = None

    def __len__(self) -> int:
        return len(self.base)

    @property
    def base(self) -> Field:
        """All n as they were."""
        return self._all.base

    @property
    def moves(self) -> Tensor:
        """[n,3] how far each anchor goes in steps, by itself and with its group."""
        parameters = self.optimiser.parameters
        own = parameters["position"]
        return own if self._groups is None else self._groups.moved(own, parameters["shift"], parameters["turn"])

    def bits(self, moves: Tensor) -> Tensor:
        """[] that the residuals of all n would take; `moves` as above.

        Rewritten anchors count too: without them training was measured to be worse (docs/history.md).
        """
        return residual_bits(self.optimiser.parameters["latent"], moves)

    def by_residuals(self) -> Field:
        """All n with their residuals."""
        return self._all.now(self.optimiser.parameters["latent"], self.moves)

    def field(self, moves: Tensor | None = None) -> Field:
        """As they will be sent: those that residuals change, and behind them those of which all numbers are sent.

        Args:
            moves: as above, where they are at hand.
        """
        changed = self._kept.now(self.optimiser.parameters["latent"], self.moves if moves is None else moves)
        return changed if self._whole is None else self._whole.behind(changed)

    def starting_at(self, position: Tensor) -> Field:
        """All n if they began `position` [n,3] steps from where they were."""
        return self._all.now(self.optimiser.parameters["latent"].detach(), position)

    def begin_at(self, position: Tensor) -> None:
        """Let their positions begin there."""
        with torch.no_grad():
            self.optimiser.parameters["position"].copy_(position)

    def send_whole(self, new: dict[str, Tensor], rewritten: Tensor) -> None:
        """Send all numbers of `new` anchors and of `rewritten` ones, and train them from now on; once a frame.

        Args:
            new: the seven arrays of a field. rewritten: [m] ascending numbers among the n.
        """
        if not len(new["level"]) and not len(rewritten):
            return
        with torch.no_grad():
            old = values_of(self.by_residuals(), rewritten)
        if len(rewritten):
            others = torch.ones(len(self), dtype=torch.bool, device=rewritten.device)
            others[rewritten] = False
            self._rewritten, self._kept = rewritten, self._all.only(torch.nonzero(others)[:, 0])
        start = {name: torch.cat([old[name], values]) for name, values in new.items()}
        self._whole = AddedAnchors(start, self._kept.base, self._scene, self.optimiser)

    def step(self, config: PredictConfig, decay: float) -> None:
        """Apply the gradients; rates have fallen to the share `decay`."""
        rates = {"latent": config.latent_rate, "position": config.position_rate}
        rates |= dict.fromkeys(("shift", "turn"), config.group_rate)
        whole = {} if self._whole is None else self._whole.rates(config.position_rate, decay)
        self.optimiser.step({name: rate * decay for name, rate in rates.items()} | whole)

    def average(self) -> None:
        """Count the present numbers into the mean."""
        self._mean.count(self.optimiser.parameters)

    @torch.no_grad()
    def settle(self) -> None:
        """All numbers become their means over the steps that were counted, if any were."""
        for name, mean in self._mean.values.items():
            self.optimiser.parameters[name].copy_(mean)

    @property
    def kept(self) -> Int64:
        """[k] ascending numbers of those that residuals change: they are the first rows of `field`, in this order."""
        rows = self._kept.rows
        return np.arange(len(self)) if rows is None else rows.cpu().numpy()

    def update(self, shown: Bool, steps: int, loss: float) -> IntegerUpdate:
        """All that is sent, as integers.

        Args:
            shown: for each row of `field`; the others are removed, or not added.
            steps, loss: of the training.
        """
        latent, position = map(_finite_integers, (self.optimiser.parameters["latent"], self.moves))
        wanted, added, heirs = self.wanted(), None, None
        if self._whole is not None:
            first, field = len(self._kept.base), self.field()
            new = np.flatnonzero(shown[first:])
            chosen = field.with_rows(torch.from_numpy(new + first).to(field.feature.device))
            added = added_levels(chosen, self._whole.moved[new], self._scene.header)
            old = self._rewritten.cpu().numpy()
            heirs = np.full(len(field) - first, -1)
            heirs[: len(old)] = old
            heirs = heirs[new][np.argsort(chosen.level.cpu().numpy(), kind="stable")]
            latent[old], position[old] = 0, self._steps_gone(field, first)
            wanted[old] = np.concatenate([latent[old], position[old]], axis=1)  # heirs have all of it in their numbers
        removed = np.ones(len(self), np.bool_)
        removed[self.kept] = ~shown[: len(self.kept)]
        return IntegerUpdate(
            latent,
            position,
            removed,
            added,
            steps,
            loss,
            self.optimiser.broken,
            wanted=wanted,
            heirs=heirs,
        )

    def wanted(self) -> Float32:
        """[n,27] latents and positions before rounding."""
        wanted = torch.cat([self.optimiser.parameters["latent"], self.moves], dim=1).detach()
        return np.asarray(wanted.nan_to_num(0.0, 0.0, 0.0).cpu().numpy())

    def _steps_gone(self, field: Field, first: int) -> Int32:
        """[m,3] how far the rewritten anchors have gone: rows of `field` from `first` on."""
        now, before = field.position[first : first + len(self._rewritten)], self.base.position[self._rewritten]
        return _finite_integers((now - before) / self._all.unit.position[self._rewritten])


def _finite_integers(values: Tensor) -> Int32:
    """Integers as training saw them; what is not finite stays at its last good state, zero."""
    rounded = dead_zone(torch.nan_to_num(values.detach(), 0.0, 0.0, 0.0)).clamp(-MAX_STEPS, MAX_STEPS)
    return rounded.to(torch.int32).cpu().numpy()
