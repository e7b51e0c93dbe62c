"""The scene along a ray: where a viewer's tap lands, and how far away the things are that a camera looks at.

One rule for all viewers: the server asks it for those that cannot draw, and the page's copy (`pick` and `depthAlong` in
`client/web/view/engine.js`) is tested against it. A ray hits a Gaussian with an opacity of at least 0.2, farther than
0.02 world units in front of its origin, with a standard deviation along the ray of at most half of its depth (renderers
leave out what has more along the view's axis, codec/FORMAT.md section 14; a ray has no view), whose centre lies nearer
to the ray than the root of the larger of

* twice the largest of its variances along the world's axes,
* the square of 0.004 of its depth, about four pixels of a usual picture, so that distant points can be hit at all.
"""

from __future__ import annotations

import numpy as np

from streamlod.core.arrays import Float32, Float64
from streamlod.core.scene.gaussians import GaussianCloud

MIN_OPACITY = 0.2
MIN_DEPTH = 0.02  # world units
MAX_SPREAD = 0.5  # of the depth
VARIANCES = 2.0
MIN_REACH = 0.004  # of the depth
CONE = 1.1  # of the squared depth: anchors within about 18 degrees of a camera's axis


def pick(cloud: GaussianCloud, origin: Float64, direction: Float64) -> Float64 | None:
    """[3] the point of the ray at the depth of the nearest Gaussian that it hits, None where it hits nothing.

    Args:
        origin: [3] world. direction: [3] of unit length.
    """
    away = cloud.means - origin
    depth = away @ direction
    apart = (away**2).sum(axis=1) - depth**2
    axes = _axes(cloud)
    reach = np.maximum(VARIANCES * (axes**2).sum(axis=2).max(axis=1, initial=0), (MIN_REACH * depth) ** 2)
    drawn = ((direction @ axes) ** 2).sum(axis=1) <= (MAX_SPREAD * depth) ** 2
    hit = depth[(cloud.opacities >= MIN_OPACITY) & (depth > MIN_DEPTH) & drawn & (apart < reach)]
    return np.asarray(origin + hit.min() * direction) if len(hit) else None


def depth_along(anchors: Float32 | Float64, origin: Float64, direction: Float64) -> float:
    """Median depth of the `anchors` [N,3] in a cone around a camera's axis, 0 where there is none.

    Args:
        origin: [3] world. direction: [3] of unit length.
    """
    away = anchors - origin
    depth = away @ direction
    near = depth[(depth > 0) & ((away**2).sum(axis=1) < CONE * depth**2)]
    return float(np.sort(near)[len(near) // 2]) if len(near) else 0.0


def _axes(cloud: GaussianCloud) -> Float64:
    """[G,3,3] R diag(s) of each Gaussian's covariance R diag(s^2) R^T."""
    w, x, y, z = (cloud.quaternions / np.linalg.norm(cloud.quaternions, axis=1, keepdims=True)).T.astype(np.float64)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return np.asarray(np.moveaxis(rotation, 2, 0) * cloud.scales[:, None])
