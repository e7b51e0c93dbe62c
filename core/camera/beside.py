"""Views beside cameras: on the way from each to its nearest neighbour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from streamlod.core.camera.camera import Camera


def views_beside(cameras: Sequence[Camera], share: float) -> list[Camera]:
    """A view from each camera `share` of the way to its nearest neighbour; each pair's middle only once."""
    views, pairs = list[Camera](), set[frozenset[int]]()
    for number, camera in enumerate(cameras):
        distances = [float(np.linalg.norm(camera.centre - other.centre)) for other in cameras]
        distances[number] = np.inf
        nearest = int(np.argmin(distances))
        pair = frozenset((number, nearest))
        if share != 0.5 or pair not in pairs:
            views.append(between(camera, cameras[nearest], share))
        pairs.add(pair)
    return views


def between(camera: Camera, other: Camera, share: float) -> Camera:
    """A view on the straight way from `camera` to `other`, turned as far, in pictures of the size of `camera`'s."""
    rotations = np.stack([each.world_to_camera[:3, :3] for each in (camera, other)])
    turned = Slerp([0.0, 1.0], Rotation.from_matrix(rotations))([share]).as_matrix()[0]
    pose = np.eye(4)
    pose[:3, :3] = turned
    pose[:3, 3] = -turned @ ((1 - share) * camera.centre + share * other.centre)
    return replace(camera, name=f"{camera.name} {share:g} {other.name}", world_to_camera=pose)
