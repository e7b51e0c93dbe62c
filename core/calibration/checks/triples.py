"""Points that three cameras see, against the poses: a camera that was turned along its own epipolar lines.

Two views agree with any point on an epipolar line, three with one point alone. For each three cameras, the reprojection
error that is left after triangulation shows whether their poses agree. The part of a camera's turn that would be left
in it shows whether it can judge that camera (where the two others stand side by side, they hardly know where the third
sees a point).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from streamlod.core.arrays import Float64, Int64
from streamlod.core.calibration.checks.matches import PairMatches
from streamlod.core.camera import Camera

MIN_POINTS = 12
_MAX_POINTS = 100  # more tell no more
_TELLS = 0.2  # part of a turn that has to be left in a camera's picture
_ROUNDS = 5
_HELD = 1e-9  # holds points that cameras at one place leave open


@dataclass(frozen=True, slots=True)
class Agreement:
    """How well two or three cameras agree.

    Attributes:
        cameras: their numbers. miss: pixels at a width of 1000.
        told: numbers of the cameras whose poses a small miss confirms: of three, those whose turn would show in it.
    """

    cameras: tuple[int, ...]
    miss: float
    told: tuple[int, ...]


def agreements_of_three(pairs: Sequence[PairMatches], cameras: Sequence[Camera]) -> list[Agreement]:
    """The agreements of all three cameras with enough points in common."""
    by_pair = {(pair.first, pair.second): pair for pair in pairs}
    centres = np.array([camera.centre for camera in cameras])
    middle = centres.mean(axis=0)
    spread = float(np.linalg.norm(centres - middle, axis=1).mean()) or 1.0
    views = np.array([_projection(camera, middle, spread) for camera in cameras])
    found = []
    for three in combinations(range(len(cameras)), 3):
        points = _shared(by_pair, three)
        if len(points) >= MIN_POINTS:
            chosen = points[np.linspace(0, len(points) - 1, min(len(points), _MAX_POINTS)).astype(int)]
            scales = np.array([1000 / cameras[number].width for number in three])
            miss, told = _left(views[list(three)], chosen * scales[:, None])
            found.append(Agreement(three, miss, tuple(np.array(three)[told >= _TELLS].tolist())))
    return found


def _projection(camera: Camera, middle: Float64, spread: float) -> Float64:
    """[3,4] from points about the rig's middle, in units of its spread, to pixels at a picture width of 1000."""
    pose = camera.world_to_camera[:3]
    moved = np.concatenate([pose[:, :3] * spread, (pose[:, 3] + pose[:, :3] @ middle)[:, None]], axis=1)
    scale = np.array([1000 / camera.width, 1000 / camera.width, 1.0])
    return np.asarray(scale[:, None] * (camera.intrinsics @ moved), np.float64)


def _shared(by_pair: dict[tuple[int, int], PairMatches], three: tuple[int, int, int]) -> Float64:
    """[N,3,2] pixels of what three cameras see, by matches of two pairs of them."""
    rows, places = [], []
    for hub in three:
        ends = [number for number in three if number != hub]
        links = [_linked(by_pair, hub, end) for end in ends]
        _, one, other = np.intersect1d(links[0][0][:, 0], links[1][0][:, 0], return_indices=True)
        numbers = {hub: links[0][0][one, 0], ends[0]: links[0][0][one, 1], ends[1]: links[1][0][other, 1]}
        pixels = {hub: links[0][1][one, 0], ends[0]: links[0][1][one, 1], ends[1]: links[1][1][other, 1]}
        rows.append(np.stack([numbers[number] for number in three], axis=1))
        places.append(np.stack([pixels[number] for number in three], axis=1))
    _, kept = np.unique(np.concatenate(rows), axis=0, return_index=True)
    return np.asarray(np.concatenate(places)[kept], np.float64)


def _linked(by_pair: dict[tuple[int, int], PairMatches], hub: int, end: int) -> tuple[Int64, Float64]:
    """[N,2] numbers of features and [N,2,2] their pixels, those of `hub` first."""
    pair = by_pair.get((min(hub, end), max(hub, end)))
    if pair is None:
        return np.zeros((0, 2), np.int64), np.zeros((0, 2, 2))
    order = slice(None) if hub < end else slice(None, None, -1)
    return pair.features[:, order], pair.points[:, order]


def _left(views: Float64, pixels: Float64) -> tuple[float, Float64]:
    """The median miss of points [N,3,2] by three projections [3,3,4]; and [3] for each camera the part of a
    displacement of its picture that would be left, whichever its direction, 0 to 1.

    Points are homogeneous of length one, so that those far away, and those that only lines behind the cameras
    explain, are as good as others.
    """
    rows = pixels[..., None] * views[:, None, 2] - views[:, :2]  # [N,3,2,4]
    rows /= np.linalg.norm(rows, axis=-1, keepdims=True)
    points = np.linalg.svd(rows.reshape(-1, 6, 4))[2][:, -1]
    for _ in range(_ROUNDS):
        misses, slopes = _misses(views, pixels, points)
        normal = np.swapaxes(slopes, 1, 2) @ slopes
        size = np.trace(normal, axis1=1, axis2=2)[:, None, None]
        free = normal + size * (points[:, :, None] * points[:, None] + _HELD * np.eye(4))
        points = points - np.linalg.solve(free, np.swapaxes(slopes, 1, 2) @ misses[..., None])[..., 0]
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    misses, slopes = _misses(views, pixels, points)
    across = np.linalg.svd(slopes, full_matrices=False)[0][..., :3]
    kept = np.eye(6) - across @ np.swapaxes(across, 1, 2)
    blocks = np.stack([kept[:, 2 * n : 2 * n + 2, 2 * n : 2 * n + 2] for n in range(3)], axis=1)
    told = np.sqrt(np.maximum(0, np.median(np.linalg.eigvalsh(blocks)[..., 0], axis=0)))
    return float(np.median(np.linalg.norm(misses, axis=1))), np.asarray(told, np.float64)


def _misses(views: Float64, pixels: Float64, points: Float64) -> tuple[Float64, Float64]:
    """[N,6] pixels by which points [N,4] are missed, and [N,6,4] how these change with the points."""
    local = np.einsum("cij,nj->nci", views, points)
    depth = np.where(np.abs(local[..., 2]) < 1e-9, 1e-9, local[..., 2])[..., None]
    seen = local[..., :2] / depth
    slopes = (views[:, :2] - seen[..., None] * views[:, None, 2]) / depth[..., None]
    return (seen - pixels).reshape(-1, 6), slopes.reshape(-1, 6, 4)
