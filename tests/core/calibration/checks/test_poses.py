"""Poses of rendered rigs in which one camera was knocked, and of right ones, by what their pictures share."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import cv2
import numpy as np
import pytest

from streamlod.core.calibration.checks.agreement import agreements
from streamlod.core.calibration.checks.matches import PairMatches, matched
from streamlod.core.calibration.checks.poses import judged
from streamlod.core.camera import Camera
from streamlod.core.data import open_dataset
from streamlod.core.data.lens import undistort, undistortions
from tests.core.calibration.checks import room

WIDER = np.array([[1, 0, 120.3], [0, 1, 67.7], [0, 0, 1]])
Shared = tuple[tuple[Camera, ...], list[PairMatches]]


@pytest.fixture(scope="module")
def row() -> Shared:
    rig = room.cameras(4)
    return rig, matched(room.frames(rig, 1)[0].images)


Bent = tuple[list[Camera], list[np.ndarray]]


@pytest.fixture(scope="module")
def bent() -> Bent:
    """Cameras of two kinds of lenses, and their pictures before these are undone."""
    lenses = [np.array([-0.3, 0.05, 0.001, 0, 0]), np.array([0.15, -0.1, 0, 0.001, 0])]
    cameras = [replace(camera, distortion=lenses[n % 2]) for n, camera in enumerate(room.cameras(4))]
    wide = [replace(each.undistorted(), width=720, height=405, intrinsics=WIDER @ each.intrinsics) for each in cameras]
    return cameras, [as_bent(*each) for each in zip(cameras, wide, room.frames(wide, 1)[0].images, strict=True)]


def as_bent(camera: Camera, straight: Camera, picture: np.ndarray) -> np.ndarray:
    """What a distorted camera shows of the larger picture of a pinhole beside it."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 2)
    focal, middle = camera.intrinsics[[0, 1], [0, 1]], camera.intrinsics[:2, 2]
    rays = undistort((pixels - middle) / focal, camera.distortion)
    at = rays * straight.intrinsics[[0, 1], [0, 1]] + straight.intrinsics[:2, 2] - 0.5
    maps = at.reshape(camera.height, camera.width, 2).astype(np.float32)
    return cv2.remap(picture, maps, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def faults(pairs: Sequence[PairMatches], cameras: Sequence[Camera]) -> list[str]:
    plans = undistortions(cameras, 1)
    found = judged(agreements(pairs, [plan.camera for plan in plans]), pairs, plans)
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
    assert not any(finding.severity == "fault" for finding in judged(twos, pairs, undistortions(turned, 1)))


def test_of_three_cameras_one_is_at_fault(row: Shared) -> None:
    cameras, pairs = row
    three = [pair for pair in pairs if pair.second < 3]
    (sentence,) = faults(three, knocked(cameras[:3], 1, np.array([0, 3.0, 0]), np.zeros(3)))
    assert sentence.startswith("one of ")
    assert "cam_1" in sentence.split(" was knocked or turned: what they see lies ")[0]


@pytest.mark.parametrize("seed", range(3))
def test_knocks_far_in_any_direction_are_no_exchange(row: Shared, seed: int) -> None:
    cameras, pairs = row
    turns = np.random.default_rng(seed).normal(size=(8, 3))
    for number, turn in enumerate(turns / np.linalg.norm(turns, axis=1, keepdims=True)):
        which, degrees = number % 4, 5.0 * (1 + number)
        (sentence,) = faults(pairs, knocked(cameras, which, degrees * turn, np.zeros(3)))
        assert sentence.startswith(f"{cameras[which].name} was knocked or turned")


ORDERS = [(0, 2, 1, 3), (2, 1, 0, 3), (1, 2, 0, 3)]  # two of other lenses, two of the same, three
MORE = [order for order in permutations(range(4)) if sum(number != each for number, each in enumerate(order)) == 2]
LONG = [pytest.param(order, marks=pytest.mark.long) for order in [*MORE, (3, 2, 1, 0)] if order not in ORDERS]


@pytest.mark.parametrize("order", [*ORDERS, *LONG], ids=lambda order: "".join(map(str, order)))
def test_pictures_under_each_others_names_are_told_though_lenses_differ(bent: Bent, order: tuple[int, ...]) -> None:
    """The camera in the middle, which all disagree with, is not to be blamed for two others."""
    cameras, raw = bent
    plans = undistortions(cameras, 1)
    pairs = matched([plan(raw[number]) for plan, number in zip(plans, order, strict=True)])
    (sentence,) = [
        finding.sentence
        for finding in judged(agreements(pairs, [plan.camera for plan in plans]), pairs, plans)
        if finding.severity == "fault"
    ]
    moved = [number for number in range(4) if order[number] != number]
    assert sentence.split(" are exchanged")[0].replace(" and", ",").split(", ") == [f"cam_{n}" for n in moved]
    if len(moved) > 2:
        assert ", ".join(f"cam_{order[number]}" for number in moved) in sentence


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
        pairs = matched(frame.images)
        assert not [
            each
            for each in judged(agreements(pairs, dataset.cameras), pairs, dataset.undistortions)
            if each.severity == "fault"
        ]


def test_cameras_of_which_a_turn_would_not_be_seen_are_told(row: Shared) -> None:
    cameras, pairs = row
    two = [pair for pair in pairs if (pair.first, pair.second) == (1, 2)]
    sentences = [finding.sentence for finding in judged(agreements(two, cameras), two, undistortions(cameras, 1))]
    assert [sentence[:11] for sentence in sentences] == ["cam_0 share", "cam_3 share", "of cam_1 an"]
    assert sentences[-1].startswith("of cam_1 and cam_2 a turn to the side would not be seen")
