"""Poses of rendered rigs in which one camera was knocked, and of right ones, by what their pictures share."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from streamlod.core.calibration.checks.matches import PairMatches, matched
from streamlod.core.calibration.checks.poses import agreements, judged
from streamlod.core.camera import Camera
from streamlod.core.data import open_dataset
from tests.core.calibration.checks import room

Shared = tuple[tuple[Camera, ...], list[PairMatches]]


@pytest.fixture(scope="module")
def row() -> Shared:
    rig = room.cameras(4)
    return rig, matched(room.frames(rig, 1)[0].images)


def faults(pairs: Sequence[PairMatches], cameras: Sequence[Camera]) -> list[str]:
    found = judged(agreements(pairs, cameras), pairs, cameras)
    return [finding.sentence for finding in found if finding.severity == "fault"]


def knocked(cameras: Sequence[Camera], which: int, turn: np.ndarray, shift: np.ndarray) -> list[Camera]:
    """The rig after one camera was turned (degrees about its own axes) and moved (metres along them)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(np.radians(turn))[0], shift
    moved = replace(cameras[which], world_to_camera=pose @ cameras[which].world_to_camera)
    return [moved if number == which else camera for number, camera in enumerate(cameras)]


@pytest.mark.parametrize("which", range(4))
def test_a_camera_turned_or_moved_in_any_direction_is_named_alone(row: Shared, which: int) -> None:
    cameras, pairs = row
    for axis in np.concatenate([np.eye(3), -np.eye(3)]):
        for turn, shift in ((2.0 * axis, np.zeros(3)), (6.0 * axis, np.zeros(3)), (np.zeros(3), 0.2 * axis)):
            (sentence,) = faults(pairs, knocked(cameras, which, turn, shift))
            assert sentence.startswith(f"{cameras[which].name} was knocked or turned"), (axis, turn, shift)


def test_a_turn_along_the_row_is_seen_by_threes_alone(row: Shared) -> None:
    """Each two still agree, so nothing else would find it."""
    cameras, pairs = row
    turned = knocked(cameras, 1, np.array([0, 2.0, 0]), np.zeros(3))
    twos = [each for each in agreements(pairs, turned) if len(each.cameras) == 2]
    assert faults(pairs, turned) != []
    assert any(1 in each.cameras and each.miss < 3 for each in twos)
    assert not any(finding.severity == "fault" for finding in judged(twos, pairs, turned))


def test_of_three_cameras_one_is_at_fault(row: Shared) -> None:
    cameras, pairs = row
    three = [pair for pair in pairs if pair.second < 3]
    (sentence,) = faults(three, knocked(cameras[:3], 1, np.array([0, 3.0, 0]), np.zeros(3)))
    assert sentence.startswith("one of ")
    assert "cam_1" in sentence.split(" was knocked or turned: what they see lies ")[0]


def test_neighbours_in_a_row_that_are_exchanged_are_named(row: Shared) -> None:
    cameras, pairs = row
    swapped = [cameras[number] for number in (0, 2, 1, 3)]
    named = [replace(camera, name=right.name) for camera, right in zip(swapped, cameras, strict=True)]
    (sentence,) = faults(pairs, named)
    assert sentence.startswith("cam_1 and cam_2 are exchanged")


def test_a_picture_that_is_far_off_may_be_another_cameras(row: Shared) -> None:
    cameras, pairs = row
    for degrees, expected in ((2.0, False), (25.0, True)):
        (sentence,) = faults(pairs, knocked(cameras, 1, np.array([degrees, 0, 0]), np.zeros(3)))
        assert ("names right if another camera filmed this" in sentence) == expected, sentence


def test_two_knocked_cameras_are_named() -> None:
    cameras = room.cameras()
    pairs = matched(room.frames(cameras, 1)[0].images)
    both = knocked(cameras, 1, np.array([0, 3.0, 0]), np.zeros(3))
    sentences = faults(pairs, knocked(both, 4, np.array([0, -2.0, 0]), np.zeros(3)))
    assert sorted(sentence[:20] for sentence in sentences) == ["cam_1 was knocked or", "cam_4 was knocked or"]


@pytest.mark.parametrize("blur", [2.0, 3.0, 4.0])
def test_right_rigs_that_share_few_features_have_no_fault(row: Shared, blur: float) -> None:
    cameras, pairs = row
    images = [cv2.GaussianBlur(picture, (0, 0), blur) for picture in room.frames(cameras, 1)[0].images]
    few = matched(images)
    assert sum(len(pair.points) for pair in few) < 0.5 * sum(len(pair.points) for pair in pairs)
    assert faults(few, cameras) == []


@pytest.mark.long
@pytest.mark.parametrize("name", ["caliscope_4cam", "stage"])
def test_right_calibrations_of_recordings_have_no_fault(real_data: Path, name: str) -> None:
    dataset = open_dataset(real_data / name)
    for index in (0, dataset.frame_count // 2):
        with closing(dataset.frames(index, index + 1)) as frames:  # type: ignore[type-var]
            (frame,) = frames
        assert faults(matched(frame.images), dataset.cameras) == []


def test_cameras_of_which_a_turn_would_not_be_seen_are_told(row: Shared) -> None:
    cameras, pairs = row
    two = [pair for pair in pairs if (pair.first, pair.second) == (1, 2)]
    sentences = [finding.sentence for finding in judged(agreements(two, cameras), two, cameras)]
    assert [sentence[:11] for sentence in sentences] == ["cam_0 share", "cam_3 share", "of cam_1, c"]
    assert sentences[-1].startswith("of cam_1, cam_2 a turn to the side would not be seen")
