"""How exactly each anchor of a keyframe has to be known, from how much the pictures depend on it.

Rounding a parameter with a step of width d costs d^2 / 12 times its sensitivity in squared error, and a bit fewer for
each doubling of d; so at equal cost a bit, d is inversely proportional to the root of the sensitivity (reverse
water-filling, Cover and Thomas, section 10.3.3). Anchors differ by factors of a thousand, their parameters little.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from core.train.rounding import Steps

COARSEST = 5  # doublings of the finest step
USUAL = 2  # where nothing is known yet
_SEARCH = 30  # halvings of an interval of offsets in doublings


def sensitivities(
    parameters: tuple[Tensor, ...], draw: Callable[[int, tuple[Tensor, ...]], Tensor], views: list[int], seed: int
) -> tuple[Tensor, ...]:
    """[N,...] growth of the squared error, summed over all values of all pictures, with the square of each parameter.

    The diagonal of J^T J by random signs (Hutchinson's estimator; Bekas et al. 2007): one backward pass a view.

    Args:
        parameters: leaves.
        draw: the picture [H,W,3] of a view made from parameters that require gradients.
        views: which views.
    """
    generator = torch.Generator().manual_seed(seed)
    total = tuple(torch.zeros_like(value) for value in parameters)
    for number in views:
        leaves = tuple(value.detach().clone().requires_grad_() for value in parameters)
        image = draw(number, leaves)
        signs = torch.randint(0, 2, image.shape, generator=generator).to(image) * 2 - 1
        for sum_, gradient in zip(total, torch.autograd.grad((image * signs).sum(), leaves), strict=True):
            sum_.add_(gradient.nan_to_num(0.0, 0.0, 0.0) ** 2)
    return total


def row_shifts(found: tuple[Tensor, Tensor, Tensor], steps: Steps, budget: float) -> Tensor:
    """[N] int64 doublings of the finest steps, such that rounding adds `budget` to the squared error.

    Args:
        found: sensitivities of features [N,F], offsets [N,K,3] and scalings [N,6].
        budget: summed over all values of all pictures.
    """
    widths = (steps.feature, steps.offset, steps.scaling)
    cost = torch.stack([(h.flatten(1) * width**2 / 12).sum(dim=1) for h, width in zip(found, widths, strict=True)])
    row = cost.sum(dim=0).double()
    wanted = -0.5 * row.clamp_min(1e-12 * row.max().clamp_min(1e-30)).log2()
    low, high = float(-wanted.max()) - 1, float(COARSEST - wanted.min()) + 1
    for _ in range(_SEARCH):
        middle = (low + high) / 2
        spent = (row * 4.0 ** _rounded(wanted + middle)).sum()
        low, high = (low, middle) if spent > budget else (middle, high)
    return _rounded(wanted + low)


def _rounded(shifts: Tensor) -> Tensor:
    return shifts.round().clamp(0, COARSEST).long()
