"""Bounds that keep a lens from folding: it shows each part of its picture once, also where the board never was.

The distorted radius r (1 + k1 r^2 + k2 r^4 + k3 r^6) has to rise with r, and to reach the picture's farthest corner.
Both are linear in the coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment.bounds import LinearBounds

_REACH = 1.5  # times the distorted radius of the corner: the radius within which it has to be reached
_RADII = 8
_RISE = 0.15  # least slope
_BEYOND = 1.05  # times the corner's radius
_PLACES = (4, 5, 8)  # of k1, k2, k3 in a lens


def unfolded_lenses(lenses: Float64, sizes: Sequence[tuple[int, int]], per_camera: int) -> LinearBounds:
    """The bounds for pictures of `sizes`, whose focal lengths and centres are near those of `lenses` [C,9].

    Args:
        per_camera: values of a camera, of which the first nine are its lens.
    """
    rows, least = (
        np.zeros((len(sizes), _RADII + 1, len(sizes), per_camera)),
        np.full((len(sizes), _RADII + 1), _RISE - 1),
    )
    for number, (lens, (across, down)) in enumerate(zip(lenses, sizes, strict=True)):
        fx, fy, cx, cy = lens[:4]
        corner = float(np.hypot(max(cx, across - cx) / fx, max(cy, down - cy) / fy))
        end = _REACH * corner
        radii = end * np.linspace(0.3, 1, _RADII)
        rows[number, :_RADII, number, _PLACES] = 3 * radii**2, 5 * radii**4, 7 * radii**6
        rows[number, _RADII, number, _PLACES] = end**3, end**5, end**7
        least[number, _RADII] = _BEYOND * corner - end
    return LinearBounds(rows.reshape(least.size, -1), least.ravel())
