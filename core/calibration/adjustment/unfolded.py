"""Bounds that keep a lens from folding: it shows each part of its picture once, also where the board never was.

The distorted radius r (1 + k1 r^2 + k2 r^4 + k3 r^6) has to rise with r, and to reach the picture's farthest corner.
Both are linear in the coefficients; what lies beyond a bound becomes a large residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from streamlod.core.arrays import Float64, Int64

_REACH = 1.5  # times the distorted radius of the corner: the radius within which it has to be reached
_RADII = 8
_RISE = 0.15  # least slope
_BEYOND = 1.05  # times the corner's radius
_WEIGHT = 300.0  # pixels for each unit beyond a bound
_BEND = 0.03  # units beyond it in which that weight is reached: a search stops at a sharp edge
_PLACES = (4, 5, 8)  # of k1, k2, k3 in a lens


@dataclass(frozen=True, slots=True, eq=False)
class UnfoldedLenses:
    """Bounds rows @ values >= least, R of them.

    Attributes:
        rows: [R,P] sparse. least: [R].
    """

    rows: csr_matrix
    least: Float64

    def misses(self, values: Float64) -> Float64:
        """[R] residuals of `values` [P]; 0 inside the bounds."""
        beyond = np.maximum(self.least - self.rows @ values, 0)
        return np.asarray(_WEIGHT * beyond**2 / (beyond + _BEND), np.float64)

    def slopes(self, values: Float64) -> csr_matrix:
        """[R,P] derivatives of the residuals."""
        beyond = np.maximum(self.least - self.rows @ values, 0)
        growth = -_WEIGHT * beyond * (beyond + 2 * _BEND) / (beyond + _BEND) ** 2
        return self.rows.multiply(growth[:, None]).tocsr()


def unfolded_lenses(lenses: Float64, sizes: Sequence[tuple[int, int]], per_camera: int, width: int) -> UnfoldedLenses:
    """The bounds for pictures of `sizes`, whose focal lengths and centres are near those of `lenses` [C,9].

    Args:
        per_camera: values of a camera, of which the first nine are its lens.
        width: P, number of all values.
    """
    coefficients, least, columns = [], [], []
    for number, (lens, (across, down)) in enumerate(zip(lenses, sizes, strict=True)):
        fx, fy, cx, cy = lens[:4]
        corner = float(np.hypot(max(cx, across - cx) / fx, max(cy, down - cy) / fy))
        radii = _REACH * corner * np.linspace(0.3, 1, _RADII)
        coefficients.append(np.stack([3 * radii**2, 5 * radii**4, 7 * radii**6], axis=1))
        least.append(np.full(_RADII, _RISE - 1))
        end = _REACH * corner
        coefficients.append(np.array([[end**3, end**5, end**7]]))
        least.append(np.array([_BEYOND * corner - end]))
        columns.append(np.tile(np.array(_PLACES, np.int64) + number * per_camera, (_RADII + 1, 1)))
    values, places = np.concatenate(coefficients), np.concatenate(columns)
    pointers: Int64 = np.arange(0, 3 * len(values) + 1, 3)
    return UnfoldedLenses(
        csr_matrix((values.ravel(), places.ravel(), pointers), (len(values), width)), np.concatenate(least)
    )
