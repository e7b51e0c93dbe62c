"""Adam over named tensors whose rows may come and go.

torch's own Adam keeps its state by parameter object, so growing a parameter means surgery on it; here the state is a
plain value beside the parameter. Equations: Kingma and Ba 2015, algorithm 1, with epsilon 1e-15 as in 3DGS. On the CPU
a step is one numba pass over each parameter.
"""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor

from core.train.kernels.adam import adam_step

_BETA1, _BETA2, _EPSILON = 0.9, 0.999, 1e-15


class RowAdam:
    """Adam with a rate a parameter, given at each step.

    Args:
        parameters: by name; leaf tensors that require gradients.
        memory: beta_1, the share of the mean gradient that each step keeps.
    """

    def __init__(self, parameters: dict[str, Tensor], memory: float = _BETA1) -> None:
        self.parameters = dict(parameters)
        self._moments = {name: _zeros(value) for name, value in parameters.items()}
        self._steps, self._memory = 0, memory
        self._broken: list[Tensor] = []

    @property
    def broken(self) -> int:
        """Gradient entries so far that were not finite and were taken as zero."""
        return sum(int(count) for count in self._broken)

    def step(self, rates: dict[str, float]) -> None:
        """Apply the gradients and clear them."""
        self._steps += 1
        correction1, correction2 = 1 - self._memory**self._steps, 1 - _BETA2**self._steps
        with torch.no_grad():
            for name, value in self.parameters.items():
                gradient, value.grad = value.grad, None
                if gradient is None or rates.get(name, 0.0) == 0.0:
                    continue
                first, second = self._moments[name]
                # counted on the device and read at the end: asking here would stall a GPU at every step
                rate = rates[name] / correction1
                self._count_broken(update(value, gradient, first, second, rate, correction2, self._memory))

    def replace_rows(self, kept: Tensor, added: dict[str, Tensor]) -> None:
        """Keep the rows `kept` of every parameter named in `added` and append its new rows, with fresh moments."""
        for name, rows in added.items():
            value = torch.cat([self.parameters[name].detach()[kept], rows]).requires_grad_()
            self._moments[name] = [torch.cat([m[kept], torch.zeros_like(rows)]) for m in self._moments[name]]
            self.parameters[name] = value

    def _count_broken(self, count: Tensor) -> None:
        if self._broken:
            self._broken[0] += count
        else:
            self._broken.append(count)


def update(
    value: Tensor,
    gradient: Tensor,
    first: Tensor,
    second: Tensor,
    rate: float,
    correction2: float,
    memory: float = _BETA1,
) -> Tensor:
    """Change `value` and its moments, of one shape, in place; returns how many entries of the gradient were broken.

    Args:
        rate: learning rate over the correction of the first moment. correction2: that of the second.
        memory: beta_1.
    """
    parts = (value, gradient.contiguous(), first, second)
    if all(part.device.type == "cpu" and part.dtype == torch.float32 and part.is_contiguous() for part in parts):
        numbers = tuple(np.float32(number) for number in (rate, 1 / correction2, 1 - memory, 1 - _BETA2, _EPSILON))
        broken = np.zeros(min(numba.get_num_threads(), value.numel()), np.int64)
        adam_step(len(broken), *(part.detach().view(-1).numpy() for part in parts), numbers, broken)
        return torch.from_numpy(broken).sum()
    return update_reference(value, gradient, first, second, rate, correction2, memory)


def update_reference(
    value: Tensor,
    gradient: Tensor,
    first: Tensor,
    second: Tensor,
    rate: float,
    correction2: float,
    memory: float = _BETA1,
) -> Tensor:
    """`update` by torch, on any device."""
    broken = gradient.numel() - torch.isfinite(gradient).sum()
    gradient = gradient.nan_to_num(0.0, 0.0, 0.0)
    first.lerp_(gradient, 1 - memory)
    second.mul_(_BETA2).addcmul_(gradient, gradient, value=1 - _BETA2)
    spread = (second / correction2).sqrt_().add_(_EPSILON)
    value.addcdiv_(first, spread, value=-rate)
    return broken


def _zeros(value: Tensor) -> list[Tensor]:
    return [torch.zeros_like(value), torch.zeros_like(value)]
