"""Anchors that a later frame adds, in training.

Anchors that are there already can only be changed by residuals: in fixed directions, never in size. Of a new one all
numbers are sent, so all of them learn, rounded as they will be sent.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Int32
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.keyframe import coarseness
from streamlod.core.train.field.field import Field
from streamlod.core.train.optimise.adam import RowAdam

MAX_STEPS = 2.0**24  # of one change of a place; floating-point numbers hold all integers up to there
RATES = {"feature": 0.02, "offset": 0.04, "scaling": 0.03}  # those of the first frame (`KeyframeConfig`)
_SLOWLY = ("feature", "scaling")  # decay to the square root of what the others decay to, as there


class AddedAnchors:
    """n new anchors.

    Attributes:
        node: [n,3] world positions of their grid nodes.

    Args:
        start: the seven arrays of a field, by name, with n rows.
        known: the anchors that they are trained with. scene: what these are of, to whose steps new ones are rounded.
        optimiser: of the run that they join.
    """

    def __init__(self, start: dict[str, Tensor], known: Field, scene: Scene, optimiser: RowAdam) -> None:
        header, device = scene.header, known.feature.device
        base = (header.feature_steps, header.offset_steps.reshape(-1, 3), header.scaling_steps)
        steps = dict(zip(RATES, (torch.from_numpy(width.copy()).to(device) for width in base), strict=True))
        steps = {name: width * _usual_coarseness(scene) for name, width in steps.items()}
        self._rates = {name: rate / float(steps[name].mean()) for name, rate in RATES.items()}
        steps["position"] = torch.from_numpy(header.position_steps).to(device)[start["level"]][:, None]
        voxel, level = (start[name].cpu().numpy() for name in ("voxel", "level"))
        self.node = torch.from_numpy(known.octree.node_of(voxel, level)).float().to(device)
        begin = start | {"position": start["position"] - self.node}
        leaves = {f"new_{name}": (begin[name] / width).requires_grad_() for name, width in steps.items()}
        optimiser.join(leaves)
        self._parameters, self._names = optimiser.parameters, tuple(steps)
        self._steps = [steps[name].expand_as(begin[name]).contiguous() for name in self._names]
        self._fixed = {name: start[name] for name in ("level", "voxel", "extra_level")}

    @property
    def rows(self) -> dict[str, Tensor]:
        """Their features, offsets, scalings and positions, rounded; gradients go straight through the rounding."""
        values = (self._parameters[f"new_{name}"] for name in self._names)
        rounded = _Rounded.apply(self.node, *self._steps, *values)  # type: ignore[no-untyped-call]
        return dict(zip(self._names, rounded, strict=True))

    @property
    def numbers(self) -> Tensor:
        """[n,F+3K+9] features, offsets, scalings and places from their nodes, in steps, before rounding."""
        values = (self._parameters[f"new_{name}"].detach().flatten(1) for name in self._names)
        return torch.cat(list(values), dim=1)

    @property
    def widths(self) -> Tensor:
        """[n,F+3K+9] width of a step of each of `numbers`."""
        return torch.cat([step.flatten(1) for step in self._steps], dim=1)

    @torch.no_grad()
    def adopt(self, numbers: Tensor) -> None:
        """Take over `numbers` [n,F+3K+9] that were trained elsewhere."""
        widths = [step.flatten(1).shape[1] for step in self._steps]
        for name, values in zip(self._names, torch.split(numbers, widths, dim=1), strict=True):
            parameter = self._parameters[f"new_{name}"]
            parameter.copy_(values.reshape(parameter.shape))

    @property
    def moved(self) -> Int32:
        """[n,3] steps from their nodes."""
        steps = self._parameters["new_position"].detach().nan_to_num(0.0, 0.0, 0.0).clamp(-MAX_STEPS, MAX_STEPS)
        return np.asarray(steps.round().to(torch.int32).cpu().numpy())

    def behind(self, known: Field) -> Field:
        """The anchors that they are trained with, as these are now, and then they."""
        return known.with_appended(self._fixed | self.rows)

    def rates(self, position_rate: float, decay: float) -> dict[str, float]:
        """How fast each of their parameters learns.

        Args:
            position_rate: in steps. decay: share of their first rates at which all but `_SLOWLY` learn.
        """
        rates = {name: rate * (decay**0.5 if name in _SLOWLY else decay) for name, rate in self._rates.items()}
        return {f"new_{name}": rate for name, rate in (rates | {"position": position_rate * decay}).items()}


class _Rounded(torch.autograd.Function):
    """Rounds values in steps, in units of their own again; the last are offsets from nodes [n,3], and become places.

    All of them in one function, for few launches on a GPU.
    """

    @staticmethod
    def forward(ctx: Any, node: Tensor, *parts: Tensor) -> tuple[Tensor, ...]:
        steps, values = parts[: len(parts) // 2], parts[len(parts) // 2 :]
        ctx.save_for_backward(*steps)
        rounded: tuple[Tensor, ...] = tuple(torch._foreach_mul(torch._foreach_round(values), steps))
        return (*rounded[:-1], node + rounded[-1])

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        steps = ctx.saved_tensors
        gradients = torch._foreach_mul([part.contiguous() for part in upstream], steps)
        return (None, *[None] * len(steps), *gradients)


def _usual_coarseness(scene: Scene) -> float:
    """Multiple of the finest steps that the numbers of half of the living anchors are rounded to, or a finer one."""
    shifts = np.concatenate([coarseness(level, np.flatnonzero(level.alive)) for level in scene.levels])
    return 2.0 ** float(np.floor(np.median(shifts))) if len(shifts) else 1.0
