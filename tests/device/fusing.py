"""What torch.compile would leave of the launches: kernels of each compiled function, as Inductor makes them."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from core.render.compiling import Compiled
from tests.device.pretend import DeviceTensor, compiled

_KERNELS: dict[tuple[Any, ...], int] = {}


def kernels(function: Any, arguments: tuple[Any, ...]) -> int:
    """Into how many kernels Inductor fuses `function`.

    It generates them for the CPU, since for a GPU it needs one; it decides there as for a GPU which passes go together.
    """
    from torch._inductor import metrics  # which takes two seconds to load

    given = [value.held.clone() if isinstance(value, DeviceTensor) else value for value in arguments]
    key = (function, *(value is None for value in given))
    if key not in _KERNELS:
        torch._dynamo.reset()
        before = metrics.generated_kernel_count
        with torch.no_grad():
            torch.compile(function, dynamic=True)(*given)
        _KERNELS[key] = metrics.generated_kernel_count - before
    return _KERNELS[key]


def count_fused(patch: pytest.MonkeyPatch) -> None:
    """From now on a `Compiled` function on the pretend device counts in `Counts.fused` as its kernels."""

    def call(self: Compiled, *arguments: Any) -> Any:
        if not any(isinstance(value, DeviceTensor) for value in arguments):
            return self.function(*arguments)
        assert not torch.is_grad_enabled() or not any(
            isinstance(value, Tensor) and value.requires_grad for value in arguments
        ), f"{self.function.__name__} is compiled without gradients"
        with compiled(kernels(self.function, arguments)):
            return self.function(*arguments)

    patch.setattr(Compiled, "__call__", call)
