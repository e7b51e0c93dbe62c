"""Adam over named tensors whose rows may come and go.

torch's own Adam keeps its state by parameter object, so growing a parameter means surgery on it; here the state is a
plain value beside the parameter. Equations: Kingma and Ba 2015, algorithm 1, with epsilon 1e-15 as in 3DGS.
"""

from __future__ import annotations

import torch
from torch import Tensor

_BETA1, _BETA2, _EPSILON = 0.9, 0.999, 1e-15


class RowAdam:
    """Adam with a rate a parameter, given at each step.

    Args:
        parameters: by name; leaf tensors that require gradients.
    """

    def __init__(self, parameters: dict[str, Tensor]) -> None:
        self.parameters = dict(parameters)
        self._moments = {name: _zeros(value) for name, value in parameters.items()}
        self._steps = 0
        self._broken: list[Tensor] = []

    @property
    def broken(self) -> int:
        """Gradient entries so far that were not finite and were taken as zero."""
        return sum(int(count) for count in self._broken)

    def step(self, rates: dict[str, float]) -> None:
        """Apply the gradients and clear them."""
        self._steps += 1
        correction1, correction2 = 1 - _BETA1**self._steps, 1 - _BETA2**self._steps
        with torch.no_grad():
            for name, value in self.parameters.items():
                gradient, value.grad = value.grad, None
                if gradient is None or rates.get(name, 0.0) == 0.0:
                    continue
                # counted on the device and read at the end: asking here would stall a GPU at every step
                self._count_broken(gradient)
                gradient.nan_to_num_(0.0, 0.0, 0.0)
                first, second = self._moments[name]
                first.lerp_(gradient, 1 - _BETA1)
                second.mul_(_BETA2).addcmul_(gradient, gradient, value=1 - _BETA2)
                spread = (second / correction2).sqrt_().add_(_EPSILON)
                value.addcdiv_(first, spread, value=-rates[name] / correction1)

    def replace_rows(self, kept: Tensor, added: dict[str, Tensor]) -> None:
        """Keep the rows `kept` of every parameter named in `added` and append its new rows, with fresh moments."""
        for name, rows in added.items():
            value = torch.cat([self.parameters[name].detach()[kept], rows]).requires_grad_()
            self._moments[name] = [torch.cat([m[kept], torch.zeros_like(rows)]) for m in self._moments[name]]
            self.parameters[name] = value

    def _count_broken(self, gradient: Tensor) -> None:
        count = gradient.numel() - torch.isfinite(gradient).sum()
        if self._broken:
            self._broken[0] += count
        else:
            self._broken.append(count)


def _zeros(value: Tensor) -> list[Tensor]:
    return [torch.zeros_like(value), torch.zeros_like(value)]
