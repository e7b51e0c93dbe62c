"""How exactly each number of a keyframe has to be known, from how much the pictures depend on it.

Rounding a parameter with a step of width d costs d^2 / 12 times its sensitivity in squared error, and a bit fewer for
each doubling of d; so at equal cost a bit, d is inversely proportional to the root of the sensitivity (reverse
water-filling, Cover and Thomas, section 10.3.3). Anchors differ by factors of a thousand, their parameters little. So
each anchor has its own power of two, and each channel its own width below it.

Features are correlated, in what they are and in what they do. They are sent in the basis in which they are neither:
the eigenvectors of their covariance as seen through the mean sensitivity (transform coding; Goyal 2001).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from streamlod.core.train.field.field import Field
from streamlod.core.train.field.rounding import FEATURE_STEP, Precision, usual_precision

COARSEST = 7  # doublings of the finest step
_SEARCH = 30  # halvings of an interval of offsets in doublings
_FINER = 0.002  # share of the anchors that would take less than the finest step
_TRIALS = 6
_MAX_CORRECTION = 8.0  # factor between what is asked for and the budget, either way
_MAX_STEPS = 1 << 14  # steps that a parameter should stay below
_TINY = 1e-12


def signed_gradients(
    parameters: tuple[Tensor, ...], draw: Callable[[int, tuple[Tensor, ...]], Tensor], views: list[int], seed: int
) -> Iterator[tuple[Tensor, ...]]:
    """For each view, the gradients g of its picture's values summed with random signs.

    E[g g^T] is J^T J, the growth of the squared error with the parameters (Hutchinson's estimator; Bekas et al. 2007):
    one backward pass a view.

    Args:
        parameters: leaves.
        draw: the picture [H,W,3] of a view made from parameters that require gradients.
        views: which views.
    """
    generator = torch.Generator().manual_seed(seed)
    for number in views:
        leaves = tuple(value.detach().clone().requires_grad_() for value in parameters)
        image = draw(number, leaves)
        signs = torch.randint(0, 2, image.shape, generator=generator, dtype=torch.int8).to(image) * 2 - 1
        gradients = torch.autograd.grad((image * signs).sum(), leaves)
        yield tuple(gradient.nan_to_num(0.0, 0.0, 0.0) for gradient in gradients)


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """How the squared error, summed over all values of all pictures, grows with the squares of the parameters.

    Attributes:
        feature: [V,N,F] signed gradients of each view; the rest are sums over views of their squares.
        offset: [N,K,3]; scaling: [N,6].
    """

    feature: Tensor
    offset: Tensor
    scaling: Tensor


def sensitivity(found: Iterator[tuple[Tensor, ...]]) -> Sensitivity:
    """Gather signed gradients of features [N,F], offsets [N,K,3] and scalings [N,6]."""
    features, offsets, scalings = zip(*found, strict=True)
    return Sensitivity(torch.stack(features), sum(g**2 for g in offsets), sum(g**2 for g in scalings))


@torch.no_grad()
def measured_precision(field: Field, found: Sensitivity, budget: float) -> Precision:
    """Steps and basis with which rounding `field` adds `budget` to the squared error, in as few bits as possible."""
    usual = usual_precision(field, 0)
    parts: tuple[Tensor, ...] = (found.feature.square().sum(dim=0), found.offset.flatten(1), found.scaling)
    widths: tuple[Tensor, ...] = (usual.feature, usual.offset.flatten(), usual.scaling)
    rows = _row_cost(parts, widths)
    seen = rows > _TINY * rows.max()
    if budget <= 0 or not bool(seen.any()):
        return usual
    weight = torch.where(seen, 1 / rows, 0.0) / seen.sum()
    basis, inverse = _decorrelated(field.feature, found.feature, weight)
    parts = ((found.feature @ inverse.T).square().sum(dim=0), *parts[1:])
    widths = tuple((weight @ part).clamp_min(_TINY).rsqrt() for part in parts)
    rows = _row_cost(parts, widths)[seen]
    finest = (budget / len(rows) / rows).sqrt().quantile(_FINER).to(basis.dtype)
    values = (field.feature @ basis, field.offset.flatten(1), field.scaling)
    widths = tuple(
        torch.maximum(width * finest, value.abs().amax(dim=0) / _MAX_STEPS)
        for width, value in zip(widths, values, strict=True)
    )
    shift = row_shifts(_row_cost(parts, widths), budget)
    unit = FEATURE_STEP / widths[0].log().mean().exp()  # keeps what is sent of the network far from float16's limits
    feature, offset, scaling = widths
    return Precision(basis * unit, inverse / unit, feature * unit, offset.view_as(usual.offset), scaling, shift)


def tuned_precision(field: Field, found: Sensitivity, budget: float, added: Callable[[Precision], float]) -> Precision:
    """As `measured_precision`, corrected by what rounding really adds: with coarse steps pictures are far from linear.

    The widest steps within the budget are found by halving. A correction by the ratio of budget and error does not do:
    one anchor may add a hundred budgets with steps of one width, and next to nothing with others.

    Args:
        added: the squared error that rounding to a precision adds.
    """
    low, high = budget / _MAX_CORRECTION, budget * _MAX_CORRECTION
    for _ in range(_TRIALS):
        middle = math.sqrt(low * high)
        fits = added(measured_precision(field, found, middle)) <= budget
        low, high = (middle, high) if fits else (low, middle)
    return measured_precision(field, found, low)


def row_shifts(cost: Tensor, budget: float) -> Tensor:
    """[N] int64 doublings of the finest steps, such that rounding adds `budget` to the squared error.

    Args:
        cost: [N] what each row adds at the finest steps.
        budget: summed over all values of all pictures.
    """
    row = cost.double().cpu()  # one wait for the device, not one for each halving
    wanted = -0.5 * row.clamp_min(_TINY * row.max().clamp_min(1e-30)).log2()
    low, high = float(-wanted.max()) - 1, float(COARSEST - wanted.min()) + 1
    for _ in range(_SEARCH):
        middle = (low + high) / 2
        spent = (row * 4.0 ** _rounded(wanted + middle)).sum()
        low, high = (low, middle) if spent > budget else (middle, high)
    return _rounded(wanted + low).to(cost.device)


def _rounded(shifts: Tensor) -> Tensor:
    return shifts.round().clamp(0, COARSEST).long()


def _row_cost(parts: tuple[Tensor, ...], widths: tuple[Tensor, ...]) -> Tensor:
    """[N] squared error that rounding with `widths` [C] adds where the sensitivities are `parts` [N,C]."""
    return torch.stack([part @ (width**2 / 12) for part, width in zip(parts, widths, strict=True)]).sum(dim=0)


def _decorrelated(feature: Tensor, gradients: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """[F,F] the basis in which features [N,F] are uncorrelated and their effects white, and its inverse.

    Args:
        gradients: [V,N,F]. weight: [N] of each anchor's effect.
    """
    effect = torch.einsum("vni,n,vnj->ij", gradients, weight, gradients).double()
    centred = (feature - feature.mean(dim=0)).double()
    half = torch.linalg.cholesky(_regular(effect))
    _, turn = torch.linalg.eigh(_regular(half.T @ (centred.T @ centred) @ half))
    basis = half @ turn
    return basis.to(feature.dtype), torch.linalg.inv(basis).to(feature.dtype)


def _regular(matrix: Tensor) -> Tensor:
    """`matrix` with a little more on its diagonal, so that it has an inverse."""
    return matrix + torch.eye(len(matrix)).to(matrix) * (matrix.trace() / len(matrix) * 1e-6 + 1e-30)
