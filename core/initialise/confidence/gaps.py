"""Where trusted depths of several views leave gaps: elsewhere a further point adds nothing, or hangs in free space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import maximum_filter

from streamlod.core.arrays import Bool
from streamlod.core.initialise.stereo.sweep import DepthMap
from streamlod.core.initialise.views import inside, project

_BEHIND = 0.05  # relative depth by which a point must lie behind a trusted surface not to belong to it


def in_gaps(maps: Sequence[DepthMap], trusted: Sequence[Bool]) -> list[Bool]:
    """[H,W] of each of V maps: which pixels have a depth of which no other view's trusted pixels know anything.

    A view knows of a point that lies on the farthest trusted surface of the 3x3 pixels round it, or before it.

    Args:
        maps: of V views. trusted: V times [H,W], which of their pixels can be trusted.
    """
    farthest = [
        maximum_filter(np.where(good, depth_map.depth, np.float32(0)), 3)
        for depth_map, good in zip(maps, trusted, strict=True)
    ]
    found = []
    for index, depth_map in enumerate(maps):
        points = depth_map.points()
        known = np.zeros(len(points), np.bool_)
        for other, surface in enumerate(farthest):
            if other == index:
                continue
            pixels, depth = project(maps[other].camera, points)
            seen = inside(maps[other].camera, pixels, depth)
            column, row = np.where(seen[:, None], pixels, 0).astype(np.int64).T
            known |= seen & (depth < surface[row, column] * (1 + _BEHIND))
        found.append(~known.reshape(depth_map.depth.shape))
    return found
