"""Linear bounds on the values of a search, each step of which stays within them.

The step of least cost within bounds is a least distance, found as non-negative least squares (Lawson and Hanson,
Solving least squares problems, 1974, section 23.4). Penalties beyond a bound would make a search zigzag in front of it,
as they have no slope inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from streamlod.core.arrays import Bool, Float64

_REACHED = 1e-6  # units from a bound within which values lie on it


@dataclass(frozen=True, slots=True, eq=False)
class LinearBounds:
    """Bounds rows @ values >= least on the first A values of a search, R of them.

    Attributes:
        rows: [R,A]. least: [R].
    """

    rows: Float64
    least: Float64

    def only(self, columns: Bool) -> LinearBounds:
        """The bounds on the values that the mask `columns` [A] names; those on others alone are left out."""
        rows = self.rows[:, columns]
        used = rows.any(axis=1)
        return LinearBounds(rows[used], self.least[used])

    def reached(self, values: Float64) -> Float64:
        """The rows [Q,A] of the bounds on which `values` [A] lie."""
        return self.rows[self.rows @ values - self.least <= _REACHED]

    def within(self, values: Float64) -> Float64:
        """The values [A] within the bounds that are nearest to `values` [A]."""
        return values + self.nearest(values, np.zeros(len(values)), np.eye(len(values)))

    def nearest(self, values: Float64, move: Float64, matrix: Float64) -> Float64:
        """The move [A] from `values` [A] within the bounds for which (d - move)^T matrix (d - move) is least.

        Args:
            matrix: [A,A], positive definite.

        Raises:
            LinAlgError: it is not.
        """
        short = self.least - self.rows @ (values + move)
        if not (short > 0).any():
            return move
        lower = cholesky(matrix, lower=True)
        normals = solve_triangular(lower, self.rows.T, lower=True)
        lengths = np.linalg.norm(normals, axis=0)
        far = short / lengths
        system = np.vstack([normals / lengths, far / far.max()])  # in units of the farthest, or rounding decides
        target = np.append(np.zeros(len(move)), 1.0)
        rest = system @ nnls(system, target)[0] - target
        aside: Float64 = solve_triangular(lower, -rest[:-1] / rest[-1] * far.max(), lower=True, trans=1)
        return move + aside
