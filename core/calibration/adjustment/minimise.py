"""Levenberg and Marquardt's method for robust least squares over cameras and many small boards.

The normal equations are solved by their Schur complement: the boards' blocks are eliminated, and what is left has the
size of the cameras (Triggs et al., Bundle adjustment: a modern synthesis, 1999, section 6.1). The solvers for sparse
steps of `scipy.optimize.least_squares` iterate (LSMR), and take many times longer where focal lengths and distances
exchange.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix, diags

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment.bounds import LinearBounds

BLOCK = 6  # values of a board
_MAX_ROUNDS = 100
_SETTLED = 1e-7  # relative gain of a round
_MAX_DAMPING = 1e8
_HELD = 1e8  # weight of the bounds that were reached, in the certainty of what was found


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """A minimum.

    Attributes:
        values: [P] where it lies.
        normal: the normal equations there, in which bounds that were reached count like certain observations.
        residuals, weights: [R] what is left, and how much each counts.
        slopes: [R,P] derivatives of the residuals.
    """

    values: Float64
    normal: Normal
    residuals: Float64
    weights: Float64
    slopes: csr_matrix


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """J^T W J in blocks: first [A,A], mixed [A,I,6], boards [I,6,6]."""

    first: Float64
    mixed: Float64
    boards: Float64

    def damped(self, damping: float) -> Normal:
        """Larger diagonals by this part."""
        first = self.first + np.diag(damping * np.diag(self.first) + 1e-9)
        each = np.einsum("nii->ni", self.boards) * damping + 1e-9
        return Normal(first, self.mixed, self.boards + each[:, :, None] * np.eye(BLOCK))

    def reduced(self) -> tuple[Float64, Float64]:
        """The Schur complement [A,A], and mixed boards^-1 [A,I,6]."""
        ratio = np.einsum("anj,njk->ank", self.mixed, np.linalg.inv(self.boards))
        flat = self.mixed.reshape(len(self.first), -1)
        return self.first - ratio.reshape(len(self.first), -1) @ flat.T, ratio

    def step(self, gradient: Float64, first: Float64, bounds: LinearBounds) -> Float64:
        """The move x [P] within the bounds on the `first` values [A] for which x^T (N x / 2 + gradient) is least."""
        count = len(self.first)
        schur, ratio = self.reduced()
        boards = -gradient[count:].reshape(-1, BLOCK)
        free = cho_solve(cho_factor(schur), -gradient[:count] - np.einsum("ank,nk->a", ratio, boards))
        move = bounds.nearest(first, free, schur)
        rest = boards - np.einsum("anj,a->nj", self.mixed, move)
        return np.concatenate([move, np.linalg.solve(self.boards, rest[..., None]).ravel()])

    def held(self, rows: Float64) -> Normal:
        """The same where values stay on the bounds with these rows [Q,A]."""
        return replace(self, first=self.first + _HELD * rows.T @ rows)


def minimise(
    start: Float64,
    residuals: Callable[[Float64], Float64],
    jacobian: Callable[[Float64], csr_matrix],
    scale: Float64,
    boards: int,
    bounds: LinearBounds,
) -> Minimum:
    """The nearest minimum within bounds of the sum over residuals r of scale^2 (sqrt(1 + (r / scale)^2) - 1), which is
    the pseudo-Huber loss.

    Args:
        start: [P] values, at the end of which the boards stand, `BLOCK` each.
        scale: [R] residuals beyond it count by their size, not by its square; infinite where the square always counts.
        bounds: on the first values.
    """
    first = len(start) - boards * BLOCK
    values = np.concatenate([bounds.within(start[:first]), start[first:]])
    damping, settled = 1e-4, 0
    rest, slopes = residuals(values), jacobian(values)
    cost = _cost(rest, scale)
    for _ in range(_MAX_ROUNDS):
        normal, gradient = _normal(slopes, rest, scale, boards)
        while damping < _MAX_DAMPING:
            try:
                tried = values + normal.damped(damping).step(gradient, values[:first], bounds)
            except np.linalg.LinAlgError:  # far from a minimum, rounding may leave it indefinite
                damping *= 8
                continue
            found = residuals(tried)
            better = _cost(found, scale)
            if better <= cost:
                break
            damping *= 8
        else:
            break
        settled = settled + 1 if cost - better <= _SETTLED * cost else 0
        values, rest, cost, damping = tried, found, better, max(1e-10, damping / 8)
        slopes = jacobian(values)
        if settled == 2:
            break
    normal, _ = _normal(slopes, rest, scale, boards)
    normal = normal.held(bounds.reached(values[:first]))
    return Minimum(values, normal, rest, _weights(rest, scale), slopes)


def _normal(slopes: csr_matrix, rest: Float64, scale: Float64, boards: int) -> tuple[Normal, Float64]:
    """J^T W J and J^T W r."""
    weighted = diags(_weights(rest, scale)) @ slopes
    count = slopes.shape[1] - boards * BLOCK
    first = slopes[:, :count].T @ weighted
    mixed = first[:, count:].toarray().reshape(count, boards, BLOCK)
    own = slopes[:, count:]
    product = (own.T @ weighted[:, count:]).tocoo()
    blocks = np.zeros((boards, BLOCK, BLOCK))
    blocks[product.row // BLOCK, product.row % BLOCK, product.col % BLOCK] = product.data
    return Normal(first[:, :count].toarray(), mixed, blocks), weighted.T @ rest


def _weights(rest: Float64, scale: Float64) -> Float64:
    return np.asarray(1 / np.sqrt(1 + (rest / scale) ** 2), np.float64)


def _cost(rest: Float64, scale: Float64) -> float:
    return float((rest**2 / (np.sqrt(1 + (rest / scale) ** 2) + 1)).sum())
