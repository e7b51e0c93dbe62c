"""The mean of parameters over training steps (Polyak and Juditsky 1992): steadier than the last step.

Every step follows the picture of one camera, so it leaves the place where all of them agree a little.
"""

from __future__ import annotations

import torch
from torch import Tensor


class MeanOfSteps:
    """Mean of named tensors over the steps that were counted.

    Attributes:
        values: by name; empty before the first step. Not part of any graph.
    """

    def __init__(self) -> None:
        self.values: dict[str, Tensor] = {}
        self._steps = 0

    def count(self, parameters: dict[str, Tensor]) -> None:
        """One step is done and has made these of the parameters; it is the first one if there are others now."""
        now = {name: value.detach() for name, value in parameters.items()}
        if now.keys() != self.values.keys():
            self._steps, self.values = 0, {name: value.clone() for name, value in now.items()}
        self._steps += 1
        torch._foreach_lerp_([self.values[name] for name in now], list(now.values()), 1 / self._steps)
