"""Features of two pictures that are alike, beside those of OpenCV's matcher."""

from __future__ import annotations

import cv2
import numpy as np

from streamlod.core.calibration.checks.matches import Features, alike, features_of
from tests.core.calibration.checks import room


def _by_opencv(first: Features, second: Features) -> set[tuple[int, int]]:
    """Numbers of features that are each other's best match, and much better than the second best."""
    kept = []
    for one, other in ((first, second), (second, first)):
        pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(one.descriptors, other.descriptors, k=2)
        kept.append({(a.queryIdx, a.trainIdx) for a, b in pairs if a.distance < 0.8 * b.distance})
    return kept[0] & {(there, here) for here, there in kept[1]}


def test_features_that_are_alike_are_those_of_opencv() -> None:
    first, second = (features_of(picture, 1500) for picture in room.frames(room.cameras(2), 1)[0].images)
    found = alike(first, second)
    assert len(found) > 50
    assert {(int(a), int(b)) for a, b in found} == _by_opencv(first, second)


def test_pictures_without_features_match_nothing() -> None:
    flat, picture = np.zeros((80, 80, 3), np.uint8), room.frames(room.cameras(2), 1)[0].images[0]
    assert alike(features_of(flat, 100), features_of(picture, 100)).shape == (0, 2)
