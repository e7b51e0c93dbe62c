"""Anchors that a later frame adds, in training.

Anchors that are there already can only be changed by residuals: in fixed directions, never in size. Of a new one all
numbers are sent, so all of them learn, rounded as they will be sent.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from core.arrays import Int32
from core.scene.anchors import Scene
from core.scene.keyframe import coarseness
from core.train.field.field import Field
from core.train.field.rounding import round_through
from core.train.optimise.optimisers import Optimiser

_RATES = {"feature": 0.02, "offset": 0.04, "scaling": 0.03}  # those of the first frame (`KeyframeConfig`)
_SLOWLY = ("feature", "scaling")  # decay to the square root of what the others decay to, as there


class AddedAnchors:
    """n new anchors.

    Args:
        start: the seven arrays of a field, by name, with n rows.
        known: the field that they join. scene: the same, whose steps they are rounded to.
        optimiser: of their numbers.
    """

    def __init__(self, start: dict[str, Tensor], known: Field, scene: Scene, optimiser: Optimiser) -> None:
        header, device = scene.header, known.feature.device
        base = (header.feature_steps, header.offset_steps.reshape(-1, 3), header.scaling_steps)
        steps = dict(zip(_RATES, (torch.from_numpy(width.copy()).to(device) for width in base), strict=True))
        self._steps = {name: width * _usual_coarseness(scene) for name, width in steps.items()}
        self._steps["position"] = torch.from_numpy(header.position_steps).to(device)[start["level"]][:, None]
        cell = known.octree.root_cell / 2.0 ** start["level"].double()
        origin = torch.from_numpy(known.octree.origin).to(device)
        self._node = (origin + start["voxel"] * cell[:, None]).float()
        self._fixed = {name: start[name] for name in ("level", "voxel", "extra_level")}
        begin = start | {"position": start["position"] - self._node}
        leaves = {name: (begin[name] / width).requires_grad_() for name, width in self._steps.items()}
        self._rates = {name: rate / float(self._steps[name].mean()) for name, rate in _RATES.items()}
        self._optimiser = optimiser.start(leaves)

    @property
    def broken(self) -> int:
        """Gradient entries so far that were not finite and were taken as zero."""
        return self._optimiser.broken

    @property
    def rows(self) -> dict[str, Tensor]:
        """The seven arrays, rounded; gradients go straight through the rounding."""
        values = {name: round_through(value) * self._steps[name] for name, value in self._optimiser.parameters.items()}
        return self._fixed | values | {"position": self._node + values["position"]}

    @property
    def moved(self) -> Int32:
        """[n,3] steps from their nodes."""
        steps = self._optimiser.parameters["position"].detach().nan_to_num(0.0, 0.0, 0.0)
        return np.asarray(steps.round().to(torch.int32).cpu().numpy())

    def step(self, position_rate: float, decay: float) -> None:
        """Apply the gradients.

        Args:
            position_rate: in steps. decay: share of their first rates at which all but `_SLOWLY` learn.
        """
        rates = {name: rate * (decay**0.5 if name in _SLOWLY else decay) for name, rate in self._rates.items()}
        self._optimiser.step(rates | {"position": position_rate * decay})


def _usual_coarseness(scene: Scene) -> float:
    """Multiple of the finest steps that the numbers of half of the living anchors are rounded to, or a finer one."""
    shifts = np.concatenate([coarseness(level, np.flatnonzero(level.alive)) for level in scene.levels])
    return 2.0 ** float(np.floor(np.median(shifts))) if len(shifts) else 1.0
