"""The mean of parameters over training steps (Polyak and Juditsky 1992), which is steadier than the last step.

A step follows the picture of one camera alone. The mean over many steps suits all cameras.
"""

from __future__ import annotations

import torch
from torch import Tensor


class MeanOfSteps:
    """Mean of named tensors over the steps that were counted.

    Attributes:
        values: the mean by name, each of its parameter's shape and detached; empty before the first step.
    """

    def __init__(self) -> None:
        self.values: dict[str, Tensor] = {}
        self._steps = 0

    def count(self, parameters: dict[str, Tensor]) -> None:
        """Let `parameters`, as a step has left them, count into the mean; with other names it begins anew."""
        now = {name: value.detach() for name, value in parameters.items()}
        if now.keys() != self.values.keys():
            self._steps, self.values = 0, {name: value.clone() for name, value in now.items()}
        self._steps += 1
        torch._foreach_lerp_([self.values[name] for name in now], list(now.values()), 1 / self._steps)
