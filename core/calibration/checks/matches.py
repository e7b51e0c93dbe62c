"""Matched features against the poses: a camera that was knocked, or cameras whose names are exchanged.

Matches of two cameras are kept where one fundamental matrix, found without the poses, explains them; how far they lie
from the epipolar lines of the poses then says whether the poses still hold.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from streamlod.core.arrays import Bool, Float64, UInt8
from streamlod.core.calibration.checks.finding import RigFinding, fault, weak
from streamlod.core.camera import Camera

MIN_MATCHES = 20
_FEATURES = 1500
_RATIO = 0.8  # of the distances to the best and the second best match (Lowe 2004)
_NEAR = 1.5  # pixels from the epipolar line of a matrix found without the poses
_OFF = 3.0  # pixels at a width of 1000, beyond which poses do not hold
_BETTER = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class PairMatches:
    """Matches of two cameras.

    Attributes:
        first, second: numbers of the cameras.
        points: [M,2,2] pixels in the first and the second picture.
    """

    first: int
    second: int
    points: Float64


def matched(pictures: Sequence[Sequence[UInt8]]) -> list[PairMatches]:
    """Matches of all pairs of cameras that share enough, over several instants.

    Args:
        pictures: for each camera, [H,W,3] at the same instants.
    """
    sift = cv2.SIFT.create(_FEATURES)
    features = [[_features(sift, picture) for picture in of_camera] for of_camera in pictures]
    found = []
    for first, second in combinations(range(len(pictures)), 2):
        parts = [_pairs(*both) for both in zip(features[first], features[second], strict=True)]
        points = np.concatenate(parts)
        if len(points) >= MIN_MATCHES:
            points = points[_consistent(points)]
        if len(points) >= MIN_MATCHES:
            found.append(PairMatches(first, second, points))
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


def residuals(pairs: Sequence[PairMatches], cameras: Sequence[Camera]) -> Float64:
    """[C,C] of `residual`, NaN for pairs without matches."""
    found = np.full((len(cameras), len(cameras)), np.nan)
    for pair in pairs:
        miss = residual(pair, cameras[pair.first], cameras[pair.second])
        found[pair.first, pair.second] = found[pair.second, pair.first] = miss
    return found


def judged(pairs: Sequence[PairMatches], cameras: Sequence[Camera]) -> Iterator[RigFinding]:
    """Findings about cameras whose poses do not hold."""
    misses = residuals(pairs, cameras)
    seen = np.isfinite(misses).any(axis=1)
    best = np.array([np.nanmin(row) if np.isfinite(row).any() else np.nan for row in misses])
    off = np.flatnonzero(best > _OFF)
    for number in np.flatnonzero(~seen).tolist():
        yield weak(f"{cameras[number].name} shares too little with other cameras to check its pose")
    if len(off) > 1 and (pair := _exchanged(pairs, cameras, off.tolist())) is not None:
        a, b = (cameras[number].name for number in pair)
        yield fault(f"{a} and {b} are exchanged: each shows what the other's pose sees; swap their names")
        return
    if len(off) and len(off) == seen.sum():
        yield fault(
            f"no camera's pose holds (matches lie {np.nanmedian(best):.1f} pixels off at a width of "
            "1000): the calibration is of another rig, or cameras have moved; calibrate again"
        )
        return
    for number in off.tolist():
        yield fault(
            f"{cameras[number].name} was knocked or turned: what it sees lies {best[number]:.1f} "
            "pixels (at a width of 1000) from where its pose puts it; calibrate again"
        )


def _exchanged(pairs: Sequence[PairMatches], cameras: Sequence[Camera], off: list[int]) -> tuple[int, int] | None:
    """Two cameras with which exchanged all poses hold."""
    before = np.nanmedian(residuals(pairs, cameras)[off])
    options = []
    for a, b in combinations(off, 2):
        swapped = list(cameras)
        swapped[a], swapped[b] = swapped[b], swapped[a]
        misses = residuals(pairs, swapped)[off]
        options.append((float(np.nanmedian(misses)), a, b))
    after, a, b = min(options)
    return (a, b) if after < _BETTER * before and after < _OFF else None


def _features(sift: cv2.SIFT, picture: UInt8) -> tuple[Float64, NDArray[Any] | None]:
    points, descriptors = sift.detectAndCompute(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), None)
    return np.array([point.pt for point in points], np.float64).reshape(-1, 2) + 0.5, descriptors


def _pairs(first: tuple[Float64, NDArray[Any] | None], second: tuple[Float64, NDArray[Any] | None]) -> Float64:
    """[M,2,2] features that are each other's best match."""
    if first[1] is None or second[1] is None or min(len(first[0]), len(second[0])) < 2:
        return np.zeros((0, 2, 2))
    there = {m.queryIdx: m.trainIdx for m in _good(first[1], second[1])}
    back = {m.queryIdx: m.trainIdx for m in _good(second[1], first[1])}
    both = [(a, b) for a, b in there.items() if back.get(b) == a]
    return np.array([(first[0][a], second[0][b]) for a, b in both]).reshape(-1, 2, 2)


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
