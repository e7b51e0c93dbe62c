"""Adam over named tensors whose rows may come and go, and their mean over steps.

torch's own Adam keeps its state by parameter object, so growing a parameter means surgery on it; here the state is a
plain value beside the parameter. Equations: Kingma and Ba 2015, algorithm 1, with epsilon 1e-15 as in 3DGS. On the CPU
a step is one numba pass over each parameter.

A step follows the picture of one camera alone. The mean over many steps (Polyak and Juditsky 1992) suits all cameras.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import torch
from torch import Tensor

from streamlod.core.train.kernels.adam import adam_step

_BETA1, _BETA2, _EPSILON = 0.9, 0.999, 1e-15


class RowAdam:
    """Adam with a rate a parameter, given at each step.

    Attributes:
        parameters: by name.
        mean: of them over the steps that were counted, detached; empty before the first.

    Args:
        parameters: by name; leaf tensors that require gradients.
        memory: beta_1, the share of the mean gradient that each step keeps.
    """

    def __init__(self, parameters: dict[str, Tensor], memory: float = _BETA1) -> None:
        self.parameters: dict[str, Tensor] = {}
        self.mean: dict[str, Tensor] = {}
        self._moments: dict[str, list[Tensor]] = {}
        self._joined: dict[str, int] = {}  # steps that had been taken before
        self._steps, self._counted, self._memory = 0, 0, memory
        self._broken: Tensor | int = 0
        self.join(parameters)

    @property
    def broken(self) -> int:
        """Gradient entries so far that were not finite and were taken as zero."""
        return int(self._broken)

    def join(self, parameters: dict[str, Tensor]) -> None:
        """Further parameters, of which no step has been taken yet."""
        for name, value in parameters.items():
            self.parameters[name], self._moments[name] = value, [torch.zeros_like(value), torch.zeros_like(value)]
            self._joined[name] = self._steps

    def step(self, rates: dict[str, float]) -> None:
        """Apply the gradients and clear them."""
        self._steps += 1
        due = {
            name: (value, value.grad)
            for name, value in self.parameters.items()
            if value.grad is not None and rates.get(name, 0.0) != 0.0
        }
        for value in self.parameters.values():
            value.grad = None
        if due:
            values, gradients = map(list, zip(*due.values(), strict=True))
            moments = [self._moments[name] for name in due]
            steps = {name: self._steps - self._joined[name] for name in due}
            scaled = [rates[name] / (1 - self._memory ** steps[name]) for name in due]
            corrections = [1 - _BETA2 ** steps[name] for name in due]
            # counted on the device and read at the end: asking here would stall a GPU at every step
            with torch.no_grad():
                self._broken += update(values, gradients, moments, scaled, corrections, self._memory)

    def average(self) -> None:
        """Count the parameters as they are now into the mean, which begins anew where some have joined."""
        now = {name: value.detach() for name, value in self.parameters.items()}
        if now.keys() != self.mean.keys():
            self._counted, self.mean = 0, {name: value.clone() for name, value in now.items()}
        self._counted += 1
        torch._foreach_lerp_([self.mean[name] for name in now], list(now.values()), 1 / self._counted)

    def replace_rows(self, kept: Tensor, added: dict[str, Tensor]) -> None:
        """Keep the rows `kept` of every parameter named in `added` and append its new rows, with fresh moments.

        The mean begins anew.
        """
        self.mean = {}
        for name, rows in added.items():
            value = torch.cat([self.parameters[name].detach()[kept], rows]).requires_grad_()
            self._moments[name] = [torch.cat([m[kept], torch.zeros_like(rows)]) for m in self._moments[name]]
            self.parameters[name] = value


def update(
    values: list[Tensor],
    gradients: list[Tensor],
    moments: list[list[Tensor]],
    rates: list[float],
    corrections: list[float],
    memory: float = _BETA1,
) -> Tensor:
    """Change `values` and their moments in place; returns how many entries of the gradients were broken.

    On the CPU one numba pass over each; elsewhere a dozen launches for all together (`update_all`).

    Args:
        moments: first and second of each value, of its shape.
        rates: learning rates over the corrections of the first moments. corrections: those of the second moments.
        memory: beta_1.
    """
    parts = [(v, g.contiguous(), *m) for v, g, m in zip(values, gradients, moments, strict=True)]
    if not all(_fits_kernel(part) for row in parts for part in row):
        return update_all(values, gradients, moments, rates, corrections, memory)
    broken = np.zeros((len(parts), numba.get_num_threads()), np.int64)
    for row, rate, correction, lost in zip(parts, rates, corrections, broken, strict=True):
        numbers = tuple(np.float32(number) for number in (rate, 1 / correction, 1 - memory, 1 - _BETA2, _EPSILON))
        workers = min(len(lost), row[0].numel())
        adam_step(workers, *(part.detach().view(-1).numpy() for part in row), numbers, lost)
    return torch.tensor(broken.sum())


def update_all(
    values: list[Tensor],
    gradients: list[Tensor],
    moments: list[list[Tensor]],
    rates: list[float],
    corrections: list[float],
    memory: float = _BETA1,
) -> Tensor:
    """`update` by torch on any device, each operation over all values at once; nothing waits for the device.

    The root of a second moment is corrected by a factor of the rate and of epsilon, which costs no pass over memory.
    """
    firsts, seconds = ([pair[i] for pair in moments] for i in (0, 1))
    flat = torch.cat([gradient.reshape(-1) for gradient in gradients])
    sound = flat.nan_to_num(0.0, 0.0, 0.0)
    sizes = [value.numel() for value in values]
    usable = [part.view(value.shape) for part, value in zip(torch.split(sound, sizes), values, strict=True)]
    torch._foreach_lerp_(firsts, usable, 1 - memory)
    torch._foreach_mul_(seconds, _BETA2)
    torch._foreach_addcmul_(seconds, usable, usable, value=1 - _BETA2)
    roots = [math.sqrt(correction) for correction in corrections]
    spreads = torch._foreach_sqrt(seconds)
    torch._foreach_add_(spreads, [_EPSILON * root for root in roots])
    scalars = [-rate * root for rate, root in zip(rates, roots, strict=True)]
    torch._foreach_addcdiv_(values, firsts, spreads, scalars=scalars)
    return (sound != flat).sum()


def _fits_kernel(part: Tensor) -> bool:
    return part.device.type == "cpu" and part.dtype == torch.float32 and part.is_contiguous()
