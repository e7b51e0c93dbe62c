"""The space of training: the same for a rig whatever its calibration's unit, origin and axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.camera.space import UNCHANGED, VIEWING_DISTANCE, Similarity, space_of, training_space
from streamlod.core.errors import InputError

POINTS = np.array([[0.0, 1.5, 4.0], [-1.0, 0.2, 5.0], [2.0, 0.0, 3.0]])


def _camera(name: str, eye: tuple[float, float, float], target: tuple[float, float, float]) -> Camera:
    pose = look_at(np.array(eye), np.array(target), np.array([0.0, 1, 0]))
    return pinhole(name, (80, 80), (48, 32), (96, 64), pose)


INWARD = tuple(_camera(f"cam{i}", (x, 0.1 * i, 0.0), (0.2, 0.0, 5.0)) for i, x in enumerate((-2.0, -0.5, 1.0, 2.0)))


def _turn(axis: tuple[float, float, float]) -> Float64:
    """[3,3] rotation by the formula of Rodrigues."""
    angle = np.linalg.norm(axis)
    x, y, z = np.asarray(axis) / max(float(angle), 1e-9)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _pixels(camera: Camera, points: Float64) -> Float64:
    seen = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    return seen[:, :2] / seen[:, 2:] * 80


coordinates = st.tuples(*[st.floats(-1e7, 1e7)] * 3)
turns = st.tuples(*[st.floats(-2, 2)] * 3)


@settings(max_examples=60, deadline=None)
@given(exponent=st.floats(-3, 4), origin=coordinates, axis=turns)
def test_the_space_does_not_depend_on_unit_and_origin(
    exponent: float, origin: tuple[float, float, float], axis: tuple[float, float, float]
) -> None:
    change = Similarity(10.0**exponent, _turn(axis), np.array(origin))
    usual, moved = training_space(INWARD), training_space([change.camera(camera) for camera in INWARD])
    assert moved.scale == pytest.approx(usual.scale / change.scale, rel=1e-6)
    wanted = usual.positions(POINTS)
    np.testing.assert_allclose(moved.positions(change.positions(POINTS)), wanted, atol=1e-6)
    for camera in INWARD:
        there = moved.camera(change.camera(camera))
        np.testing.assert_allclose(_pixels(there, wanted), _pixels(camera, POINTS), atol=1e-4)


@pytest.mark.parametrize(
    ("scale", "origin"),
    [(1e-3, (3.0, -4.0, 100.0)), (1e3, (0.0, 0.0, 0.0)), (1e4, (1e3, -1e3, 5e2)), (1.0, (5e5, -3e5, 120.0))],
)
def test_cameras_have_the_same_numbers_to_the_last_bit(scale: float, origin: tuple[float, float, float]) -> None:
    """In millimetres, turned, or on a map: `origin` is in the units of `INWARD`."""
    change = Similarity(scale, _turn((0.3, -1.1, 0.7)), np.array(origin))
    moved, bounds = tuple(change.camera(camera) for camera in INWARD), change.depths((1.5, 9.0))
    usual, space = training_space(INWARD), training_space(moved)
    assert space.depths(bounds) == usual.depths((1.5, 9.0))
    for before, after in zip(INWARD, moved, strict=True):
        wanted = usual.camera(before).world_to_camera
        assert space.camera(after).world_to_camera.tobytes() == wanted.tobytes()
        unrounded = replace(usual, grid=0.0).camera(before).world_to_camera
        np.testing.assert_allclose(wanted, unrounded, rtol=0, atol=2**-21)


def test_the_rig_looks_at_things_four_units_away() -> None:
    space = replace(training_space(INWARD), grid=0.0)
    placed = [space.camera(camera) for camera in INWARD]
    focus = training_space(INWARD).positions(np.array([[0.2, 0.0, 5.0]]))[0]
    assert np.median([np.linalg.norm(focus - c.centre) for c in placed]) == pytest.approx(VIEWING_DISTANCE, rel=0.02)
    np.testing.assert_allclose(np.mean([camera.centre for camera in placed], axis=0), 0, atol=1e-9)


def test_axes_are_right_down_and_ahead_whatever_the_pitch() -> None:
    """Cameras of a room whose y is up, above what they look at."""
    placed = training_space([_camera(str(x), (x, 2.0, 0.0), (0.3 * x, 0.0, 4.0)) for x in (-1.0, 0.0, 1.0)])
    np.testing.assert_allclose(placed.rotation, [[-1, 0, 0], [0, -1, 0], [0, 0, 1]], atol=1e-3)


@pytest.mark.parametrize("eyes", [8, 2, 1])
def test_a_ring_and_a_single_camera_have_axes(eyes: int) -> None:
    angles = 2 * np.pi * np.arange(eyes) / eyes
    ring = [_camera(str(a), (3 * np.cos(a), 1.0, 3 * np.sin(a)), (0.0, 0.0, 0.0)) for a in angles]
    rotation = training_space(ring).rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1)
    assert rotation[1] @ [0, -1, 0] > 0.9


def test_axes_that_do_not_meet_ahead_give_the_width() -> None:
    parallel = [_camera(str(x), (x, 0.0, 0.0), (x, 0.0, 9.0)) for x in (0.0, 1.0, 2.0)]
    outward = [_camera(str(x), (x, 0.0, 0.0), (3 * x, 0.0, 0.5)) for x in (-1.0, 1.0)]
    for rig in (parallel, outward):
        assert training_space(rig).scale == pytest.approx(VIEWING_DISTANCE / (3 * 2.0))


def test_cameras_at_one_place_take_the_scale_from_the_depth() -> None:
    alone = INWARD[:1]
    assert training_space(alone, (1.0, 16.0)).scale == pytest.approx(1.0)
    assert training_space(alone, (1000.0, 16000.0)).scale == pytest.approx(1e-3)
    assert training_space([alone[0], replace(alone[0], name="b")]).scale == 1.0


def test_a_rotation_written_with_few_digits_far_from_the_origin() -> None:
    change = Similarity(1.0, np.eye(3), np.array([4e6, -1e6, 3e6]))
    written = []
    for camera in INWARD:
        pose = np.eye(4)
        pose[:3, :3] = np.round(camera.world_to_camera[:3, :3], 6)
        pose[:3, 3] = -pose[:3, :3] @ change.positions(camera.centre[None])[0]
        written.append(replace(camera, world_to_camera=pose))
    centres = [training_space(written).camera(camera).centre for camera in written]
    wanted = [training_space(INWARD).camera(camera).centre for camera in INWARD]
    np.testing.assert_allclose(centres, wanted, atol=1e-4)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_the_space_of_other_cameras_is_found_by_name(scale: float) -> None:
    change = Similarity(scale, _turn((0.3, -1.0, 0.4)), np.array([5.0, -2.0, 1.0]))
    others = [change.camera(camera) for camera in INWARD[::-1]]
    found = space_of(INWARD[1:], others)
    assert found is not None
    np.testing.assert_allclose(found.positions(POINTS), change.positions(POINTS), rtol=1e-9)
    assert space_of(INWARD, [others[0], replace(others[1], name="other")]) is None
    assert space_of([INWARD[0], replace(INWARD[0], name="cam1")], others) is None


def test_two_changes_in_one() -> None:
    first = Similarity(2.0, _turn((0.0, 0.5, 0.0)), np.array([1.0, 2.0, 3.0]))
    second = Similarity(0.1, _turn((1.0, 0.0, 0.0)), np.array([-4.0, 0.0, 2.0]))
    both = second.after(first)
    np.testing.assert_allclose(both.positions(POINTS), second.positions(first.positions(POINTS)))
    np.testing.assert_allclose(first.inverse().positions(first.positions(POINTS)), POINTS, atol=1e-12)
    np.testing.assert_allclose(UNCHANGED.after(first).positions(POINTS), first.positions(POINTS))


def test_a_scale_that_leaves_the_numbers_is_refused() -> None:
    with pytest.raises(InputError, match="beyond"):
        Similarity(1e13, np.eye(3), np.zeros(3)).camera(INWARD[0])
