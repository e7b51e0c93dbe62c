"""Numbers whose gradients are worked out together with them, as both need the same blurs or bins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor


def with_gradient(value: Tensor, leaves: Sequence[Tensor], gradients: Sequence[Tensor]) -> Tensor:
    """`value` [], whose derivatives by `leaves` are `gradients`, each of its leaf's shape."""
    known: Tensor = _Known.apply(value, len(leaves), *leaves, *gradients)  # type: ignore[no-untyped-call]
    return known


class _Known(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, value: Tensor, count: int, *parts: Tensor) -> Tensor:
        ctx.gradients = parts[count:]
        return value.view_as(value)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        known = ctx.gradients
        if upstream.device.type != "cpu" or upstream != 1:  # asking a GPU what it is would make the host wait
            known = torch._foreach_mul(known, upstream)
        return (None, None, *known, *[None] * len(known))
