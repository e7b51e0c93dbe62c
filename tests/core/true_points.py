"""First points from a synthetic clip's exact depth, for tests of what comes after them: a sweep takes seconds."""

from __future__ import annotations

import numpy as np

from streamlod.core.frames import PointCloud
from streamlod.core.initialise.views import pixel_centres, unproject
from streamlod.core.synthetic import SyntheticSpec, cameras, ground_truth, render_image

_APART = 5  # pixels of a row; a sweep finds about as many points


def true_points(spec: SyntheticSpec, views: int | None = None) -> PointCloud:
    """Every fifth pixel of frame 0 of all cameras, or of the first `views`, at its true depth."""
    positions, colours = [], []
    for number, camera in enumerate(cameras(spec)[:views]):
        truth = ground_truth(spec, 0, number)
        chosen = np.flatnonzero(np.isfinite(truth.depth.ravel()))[number % _APART :: _APART]
        depth = truth.depth.ravel()[chosen].astype(np.float64)
        positions.append(unproject(camera, pixel_centres(camera)[chosen], depth).astype(np.float32))
        colours.append(render_image(spec, 0, number).reshape(-1, 3)[chosen].astype(np.float32) / 255)
    return PointCloud(np.concatenate(positions), np.concatenate(colours))
