"""The Gaussians between two states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from streamlod.core.render.splatter import draw_cloud
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from streamlod.core.scene.gaussians import GaussianCloud
from streamlod.core.scene.interpolate import can_interpolate, interpolate
from tests.client.web.scenes import make_scene, moved
from tests.codec.scenes import grow, move
from tests.codec.scenes import make_scene as random_scene

EYE = np.array([0.3, -0.6, -2.5])


def assert_same(found: GaussianCloud, wanted: GaussianCloud, *, rounded: bool = False) -> None:
    """The same Gaussians, bit for bit but for the length of quaternions, which says nothing.

    Args:
        rounded: the last bits may differ. Some processors round the rows of a matrix product differently where there
            are more of them, as `interpolate` has where anchors come or go.
    """
    assert len(found) == len(wanted)
    bounds = {"rtol": 1e-6, "atol": 1e-7} if rounded else {"rtol": 0, "atol": 0}
    for name in ("means", "scales", "opacities", "colours"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), **bounds)
    length = np.linalg.norm(wanted.quaternions, axis=1, keepdims=True)
    turned = (found.quaternions * wanted.quaternions / length).sum(axis=1)
    np.testing.assert_allclose(np.abs(turned), 1, atol=1e-5)


def without(scene: Scene, number: int, row: int) -> Scene:
    """The next state, in which one anchor is dead and nothing else differs."""
    alive = scene.levels[number].alive.copy()
    alive[row] = False
    levels = list(scene.levels)
    levels[number] = replace(levels[number], alive=alive)
    return replace(scene, levels=tuple(levels), version=scene.version + 1)


@pytest.mark.parametrize(("step", "rounded"), [(move, False), (grow, True)])
def test_the_ends_are_the_states(step: Callable[[Scene], Scene], rounded: bool) -> None:
    before = random_scene()
    after = step(before)
    assert_same(interpolate(before, after, 0, EYE), expand(before, EYE), rounded=rounded)
    assert_same(interpolate(before, after, 1, EYE), expand(after, EYE), rounded=rounded)
    assert_same(interpolate(before, after, 1, EYE, 0), expand(after, EYE, 0), rounded=rounded)


def test_places_lie_on_straight_lines() -> None:
    before = make_scene(200)
    after = moved(before)
    first, quarter, last = (interpolate(before, after, share, EYE) for share in (0, 0.25, 1))
    assert np.abs(last.means - first.means).max() > 0.02
    np.testing.assert_allclose(quarter.means, 0.75 * first.means + 0.25 * last.means, atol=1e-6)
    np.testing.assert_allclose(quarter.opacities, 0.75 * first.opacities + 0.25 * last.opacities, atol=1e-6)


def test_what_only_one_state_has_stays_in_place_and_fades() -> None:
    whole = make_scene(200, view_dependent=False)
    less = without(whole, 2, 7)
    there, gone = expand(whole, EYE), expand(less, EYE)
    for before, after in ((whole, less), (less, replace(whole, version=2))):
        found = interpolate(before, after, 0.25, EYE)
        np.testing.assert_array_equal(found.means, there.means)
        left = 0.75 if before is whole else 0.25
        faded = found.opacities < there.opacities - 1e-4
        np.testing.assert_allclose(found.opacities[faded], left * there.opacities[faded], rtol=1e-5)
        assert faded.sum() == len(there) - len(gone) > 0


def test_a_rotation_takes_the_shorter_way() -> None:
    """A quaternion and its opposite say the same rotation; mixed as they are, they would cancel out."""
    before = make_scene(60)
    levels = []
    for level in before.levels:
        latent = level.latent.copy()
        latent[:, 6] = -60  # takes w from about 1 to about -2
        levels.append(replace(level, latent=latent))
    after = replace(before, levels=tuple(levels), version=1)
    assert expand(before, EYE).quaternions[:, 0].min() > 0 > expand(after, EYE).quaternions[:, 0].max()
    assert np.linalg.norm(interpolate(before, after, 0.5, EYE).quaternions, axis=1).min() > 0.8


def test_nothing_lies_between_states_of_two_keyframes() -> None:
    before = make_scene(60)
    for other in (replace(moved(before), keyframe=1), replace(moved(before), identifier=5)):
        assert not can_interpolate(before, other)
        with pytest.raises(ValueError, match="does not follow"):
            interpolate(before, other, 0.5, EYE)
    assert not can_interpolate(moved(before), before)
    assert can_interpolate(before, moved(before))


def test_the_middle_is_nearer_to_the_truth_than_the_state_before() -> None:
    states = [make_scene(400)]
    for _ in range(2):
        states.append(moved(states[-1]))
    camera, background = states[0].header.cameras[2], states[0].header.background
    held, true = (draw_cloud(expand(state, camera.centre), camera, background) for state in states[:2])
    mixed = draw_cloud(interpolate(states[0], states[2], 0.5, camera.centre), camera, background)
    moving = np.abs(held.astype(int) - true).max(axis=2) > 8
    errors = [np.mean((picture[moving].astype(float) - true[moving]) ** 2) for picture in (held, mixed)]
    assert errors[1] < errors[0] / 10
