"""Matched features of two cameras, and how far they lie from the epipolar lines of the poses.

Matches are kept where one fundamental matrix, found without the poses, explains them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from streamlod.core.arrays import Bool, Float64, Int64, UInt8
from streamlod.core.camera import Camera

MIN_MATCHES = 20
_FEATURES = 1500
_RATIO = 0.8  # of the distances to the best and the second best match (Lowe 2004)
_NEAR = 1.5  # pixels from the epipolar line of a matrix found without the poses


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """F features of a picture: points [F,2] in pixels and descriptors, None where there is no feature."""

    points: Float64
    descriptors: NDArray[Any] | None


@dataclass(frozen=True, slots=True, eq=False)
class PairMatches:
    """Matches of two cameras.

    Attributes:
        first, second: numbers of the cameras.
        points: [M,2,2] pixels in the first and the second picture.
        features: [M,2] numbers of the features in them.
    """

    first: int
    second: int
    points: Float64
    features: Int64


def matched(pictures: Sequence[UInt8]) -> list[PairMatches]:
    """Matches of all pairs of cameras that share enough, by one picture [H,W,3] of each."""
    features = [features_of(picture, _FEATURES) for picture in pictures]
    found = []
    for first, second in combinations(range(len(pictures)), 2):
        numbers = alike(features[first], features[second])
        points = np.stack([features[first].points[numbers[:, 0]], features[second].points[numbers[:, 1]]], axis=1)
        if len(points) >= MIN_MATCHES and (kept := _consistent(points)).sum() >= MIN_MATCHES:
            found.append(PairMatches(first, second, points[kept], numbers[kept]))
    return found


def residual(pair: PairMatches, first: Camera, second: Camera) -> float:
    """Median distance of the matches from the epipolar lines of two cameras' poses, in pixels at a width of 1000."""
    relative = second.world_to_camera @ np.linalg.inv(first.world_to_camera)
    x, y, z = relative[:3, 3]
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ relative[:3, :3]
    matrix = np.linalg.inv(second.intrinsics).T @ essential @ np.linalg.inv(first.intrinsics)
    one = np.concatenate([pair.points[:, 0], np.ones((len(pair.points), 1))], axis=1)
    other = np.concatenate([pair.points[:, 1], np.ones((len(pair.points), 1))], axis=1)
    lines, back = one @ matrix.T, other @ matrix
    miss = np.abs((other * lines).sum(axis=1))
    # Sampson's distance: Hartley and Zisserman, Multiple view geometry, equation 11.9
    slope = np.sqrt((lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1))
    return float(np.median(miss / np.maximum(slope, 1e-12)) * 1000 / first.width)


def features_of(picture: UInt8, most: int) -> Features:
    """The strongest features, at most so many, of a picture [H,W,3]."""
    points, descriptors = cv2.SIFT.create(most).detectAndCompute(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), None)
    return Features(np.array([point.pt for point in points], np.float64).reshape(-1, 2) + 0.5, descriptors)


def alike(first: Features, second: Features) -> Int64:
    """[M,2] numbers of features that are each other's best match."""
    if first.descriptors is None or second.descriptors is None or min(len(first.points), len(second.points)) < 2:
        return np.zeros((0, 2), np.int64)
    there = {m.queryIdx: m.trainIdx for m in _good(first.descriptors, second.descriptors)}
    back = {m.queryIdx: m.trainIdx for m in _good(second.descriptors, first.descriptors)}
    both = [(a, b) for a, b in there.items() if back.get(b) == a]
    return np.array(both, np.int64).reshape(-1, 2)


def _good(first: NDArray[Any], second: NDArray[Any]) -> list[cv2.DMatch]:
    found = cv2.BFMatcher(cv2.NORM_L2).knnMatch(first, second, k=2)
    return [pair[0] for pair in found if len(pair) == 2 and pair[0].distance < _RATIO * pair[1].distance]


def _consistent(points: Float64) -> Bool:
    """[M] whether one fundamental matrix explains a match."""
    try:
        _, mask = cv2.findFundamentalMat(points[:, 0], points[:, 1], cv2.USAC_MAGSAC, _NEAR, 0.999, 2000)
    except cv2.error:
        mask = None
    return np.zeros(len(points), np.bool_) if mask is None else np.ravel(mask).astype(np.bool_)
