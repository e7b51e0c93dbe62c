"""Views beside cameras and between them: on the way from each to its nearest neighbour, or to all of its neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

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


def views_between(cameras: Sequence[Camera], shares: Sequence[float]) -> list[Camera]:
    """Views at `shares` of the way, up to a half, from each camera to each of its neighbours; middles only once."""
    pairs = [(cameras[one], cameras[other]) for one, other in neighbours(cameras)]
    ways = [[*pairs, *(pair[::-1] for pair in pairs)] if share != 0.5 else pairs for share in shares]
    return [between(*pair, share) for share, both in zip(shares, ways, strict=True) for pair in both]


def neighbours(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """Pairs of cameras to both of which no third one is nearer than they are to each other.

    They connect all cameras (relative neighbourhood graph, Toussaint 1980); nearest neighbours alone may fall apart
    into groups, between which nothing would look.
    """
    centres = np.stack([camera.centre for camera in cameras])
    apart = np.linalg.norm(centres[:, None] - centres, axis=2)
    pairs = combinations(range(len(cameras)), 2)
    return [
        (one, other) for one, other in pairs if not (np.maximum(apart[one], apart[other]) < apart[one, other]).any()
    ]


def between(camera: Camera, other: Camera, share: float) -> Camera:
    """A view on the straight way from `camera` to `other`, turned as far, in pictures of the size of `camera`'s."""
    rotations = np.stack([each.world_to_camera[:3, :3] for each in (camera, other)])
    turned = Slerp([0.0, 1.0], Rotation.from_matrix(rotations))([share]).as_matrix()[0]
    pose = np.eye(4)
    pose[:3, :3] = turned
    pose[:3, 3] = -turned @ ((1 - share) * camera.centre + share * other.centre)
    return replace(camera, name=f"{camera.name} {share:g} {other.name}", world_to_camera=pose)
