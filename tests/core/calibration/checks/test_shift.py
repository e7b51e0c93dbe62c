"""Whether a camera was knocked, told by an earlier picture of its own, in a rendered room."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from streamlod.core.arrays import UInt8
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.checks.matches import Features
from streamlod.core.calibration.checks.shift import OFF, landmarks, shift
from streamlod.core.camera import Camera
from tests.core.calibration.checks import room

RIG = room.cameras(3)


def _turned(camera: Camera, axis: int, degrees: float) -> Camera:
    turn = np.eye(4)
    turn[:3, :3] = rigid.rotations(np.radians(degrees) * np.eye(3)[axis])[0]
    return replace(camera, world_to_camera=turn @ camera.world_to_camera)


def _pictures(rig: tuple[Camera, ...], instant: int = 1) -> list[UInt8]:
    return list(room.frames(rig, instant + 1)[instant].images)


def _lit(picture: UInt8, gain: float) -> UInt8:
    """Another exposure, and a lamp switched on at the right."""
    lamp = np.linspace(0.6, 1.6, picture.shape[1])[None, :, None]
    return np.clip(picture * gain * lamp, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def before() -> list[Features]:
    return [landmarks(picture) for picture in _pictures(RIG, 0)]


@pytest.mark.parametrize(("axis", "degrees"), [(0, 2.0), (1, -2.0), (1, 0.5), (1, 8.0), (2, 2.0)])
def test_a_turned_camera_has_moved_by_what_it_was_turned(before: list[Features], axis: int, degrees: float) -> None:
    """In other light too."""
    pictures = _pictures(tuple(_turned(camera, axis, degrees) for camera in RIG))
    for camera, seen, picture in zip(RIG, before, pictures, strict=True):
        expected = camera.intrinsics[0, 0] * np.radians(abs(degrees)) * 1000 / camera.width
        for now in (picture, _lit(picture, 0.7)):
            found = shift(seen, landmarks(now))
            assert found is not None
            if axis == 2:  # more at the border than in the middle
                assert OFF < found.pixels < 0.6 * expected
            else:
                assert expected * 0.95 < found.pixels < expected * 1.25


def test_a_camera_that_was_pushed_aside_has_moved(before: list[Features]) -> None:
    aside = []
    for camera in RIG:
        pose = camera.world_to_camera.copy()
        pose[0, 3] += 0.1  # metres
        aside.append(replace(camera, world_to_camera=pose))
    found = [shift(seen, landmarks(now)) for seen, now in zip(before, _pictures(tuple(aside)), strict=True)]
    assert all(each is not None and each.pixels > OFF for each in found)


@pytest.mark.long
def test_what_changes_before_a_camera_that_stands_is_no_knock(before: list[Features]) -> None:
    """Noise, lights, exposure, somebody near who fills most of the picture, and a covered lens."""
    random = np.random.default_rng(0)
    for number, picture in enumerate(_pictures(RIG)):
        noisy = np.clip(picture + random.normal(0, 12, picture.shape), 0, 255).astype(np.uint8)
        somebody, other = picture.copy(), np.roll(_pictures(RIG)[(number + 1) % 3][::-1], 40, axis=1)
        somebody[:, 60:340] = other[:, 60:340]
        for now in (picture, noisy, _lit(picture, 0.5), _lit(picture, 1.5)):
            found = shift(before[number], landmarks(now))
            assert found is not None
            assert found.pixels < 0.5
        for now in (somebody, other, np.full_like(picture, 9), cv2.GaussianBlur(picture, (0, 0), 20)):
            found = shift(before[number], landmarks(np.asarray(now, np.uint8)))
            assert found is None or found.pixels < 0.5


@pytest.mark.parametrize("size", [(1, 1), (3, 200), (8, 4000), (4000, 8)])
def test_pictures_of_any_shape_are_looked_at(size: tuple[int, int]) -> None:
    """Also those of which one side would vanish when they are made smaller."""
    seen = landmarks(np.random.default_rng(0).integers(0, 255, (*size, 3)).astype(np.uint8))
    found = shift(seen, seen)
    assert found is None or found.pixels == 0
