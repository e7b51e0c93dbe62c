"""Views on the way from a camera to its neighbour."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.camera.beside import between, neighbours, views_beside, views_between
from streamlod.core.synthetic import SyntheticSpec, cameras

SPEC = SyntheticSpec(cameras=4, frames=2, width=64, height=36, noise=0.0)


def test_a_view_at_either_end_is_the_camera_itself() -> None:
    first, second = cameras(SPEC)[1:3]
    for share, camera in ((0.0, first), (1.0, second)):
        np.testing.assert_allclose(between(first, second, share).world_to_camera, camera.world_to_camera, atol=1e-9)
    middle = between(first, second, 0.5)
    np.testing.assert_allclose(middle.centre, (first.centre + second.centre) / 2)


def test_views_lie_towards_the_nearest_camera_and_a_middle_comes_once() -> None:
    rig = cameras(SPEC)  # cam00 in the middle of an arc of three
    near = views_beside(rig, 0.1)
    assert len(near) == 4
    for camera, view in zip(rig, near, strict=True):
        closest = min(float(np.linalg.norm(camera.centre - other.centre)) for other in rig if other is not camera)
        assert np.linalg.norm(view.centre - camera.centre) == pytest.approx(0.1 * closest)
    middles = [tuple(view.centre.round(6)) for view in views_beside(rig, 0.5)]
    assert len(middles) == len(set(middles)) < 4


def cameras_at(*centres: tuple[float, ...]) -> list[Camera]:
    ahead, up = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    poses = [look_at(np.array(centre), np.array(centre) + ahead, up) for centre in centres]
    return [pinhole(f"{number}", (40, 40), (32, 18), (64, 36), pose) for number, pose in enumerate(poses)]


def test_two_pairs_of_cameras_far_apart_are_neighbours_too() -> None:
    row = cameras_at((0, 0, 0), (1, 0, 0), (10, 0, 0), (11, 0, 0))
    assert neighbours(row) == [(0, 1), (1, 2), (2, 3)]
    centres = {round(float(view.centre[0]), 6) for view in views_between(row, (0.25, 0.5))}
    assert centres == {0.25, 0.5, 0.75, 3.25, 5.5, 7.75, 10.25, 10.5, 10.75}
    assert neighbours(row[:1]) == views_between(row[:1], (0.5,)) == []


def test_neighbours_connect_all_cameras_wherever_they_stand() -> None:
    random = np.random.default_rng(0)
    for count in (2, 3, 5, 20):
        centres = random.normal(size=(count, 3))
        centres[-1] = centres[0]  # two at one place
        pairs = neighbours(cameras_at(*map(tuple, centres)))
        graph = np.zeros((count, count))
        graph[tuple(np.transpose(pairs))] = 1
        assert connected_components(graph)[0] == 1
