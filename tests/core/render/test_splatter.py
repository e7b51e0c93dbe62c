"""The cache of expanded anchors draws what the reference expansion draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from streamlod.core.errors import InputError
from streamlod.core.render.cpu import render
from streamlod.core.render.splatter import Splatter
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand, expand_slots
from streamlod.core.scene.gaussians import GaussianCloud
from tests.client.clips import plain_scene, states
from tests.codec.scenes import grow, make_scene, move


def assert_same_cloud(found: GaussianCloud, expected: GaussianCloud) -> None:
    for name in GaussianCloud.__slots__:
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=2e-5, atol=2e-6, err_msg=name)


def changing() -> list[Scene]:
    """Moves, growth, removal, then another keyframe."""
    found = states(3)
    found.append(grow(found[-1]))
    found.append(move(found[-1]))
    return [*found, replace(plain_scene(seed=5), keyframe=9, version=9)]


@pytest.mark.parametrize("levels", [None, 1, 2, 9])
def test_cached_clouds_equal_the_reference(levels: int | None) -> None:
    splatter = Splatter()
    for scene in changing():
        camera = scene.header.cameras[0]
        highest = None if levels is None else levels - 1
        assert_same_cloud(splatter.cloud(scene, camera, levels), expand(scene, camera.centre, highest))


def test_view_dependent_scenes_follow_the_camera() -> None:
    splatter, scene = Splatter(), make_scene((20, 60))
    for camera in scene.header.cameras:
        assert_same_cloud(splatter.cloud(scene, camera), expand(scene, camera.centre))


@pytest.mark.parametrize("view_dependent", [True, False])
def test_what_is_near_is_left_out_from_elsewhere(view_dependent: bool) -> None:
    scene = make_scene((20, 60)) if view_dependent else plain_scene(seed=5)
    eye = expand(scene, np.zeros(3)).means[0].astype(np.float64)
    pose = np.eye(4)
    pose[:3, 3] = -eye
    camera = replace(scene.header.cameras[0], world_to_camera=pose)
    expected = expand(scene, camera.centre)
    assert len(expected) < len(expand(replace(scene, header=replace(scene.header, cameras=())), camera.centre))
    assert_same_cloud(Splatter().cloud(scene, camera), expected)


def test_only_changed_rows_are_expanded_again(monkeypatch: pytest.MonkeyPatch) -> None:
    counted = []
    whole = expand_slots

    def counting(*arguments):  # type: ignore[no-untyped-def]
        counted.append(len(arguments[4]))
        return whole(*arguments)

    monkeypatch.setattr("streamlod.core.render.splatter.expand_slots", counting)
    first, second = states(2)
    splatter, camera = Splatter(), first.header.cameras[0]
    splatter.cloud(first, camera)
    assert sum(counted) == first.anchor_count
    counted.clear()
    splatter.cloud(second, camera)
    assert 0 < sum(counted) < first.anchor_count / 3
    counted.clear()
    splatter.cloud(second, first.header.cameras[1])
    assert counted == []


def test_picture_is_the_rendered_image_rounded() -> None:
    scene = plain_scene()
    camera = scene.header.cameras[0].scaled(96, 54)
    expected = render(expand(scene, camera.centre), camera, scene.header.background).image
    picture = Splatter().picture(scene, camera)
    assert picture.dtype == np.uint8
    assert picture.shape == (54, 96, 3)
    assert np.abs(picture / 255.0 - np.clip(expected, 0, 1)).max() <= 0.5 / 255 + 1e-4
    assert picture.std() > 1


def test_what_cannot_be_drawn_is_refused_before_there_is_room_for_it() -> None:
    scene = plain_scene()
    camera = scene.header.cameras[0]
    with pytest.raises(InputError, match="picture of 1000000x1000000 is too large"):
        Splatter().picture(scene, camera.scaled(1_000_000, 1_000_000))
    with pytest.raises(InputError, match="levels: must be at least 0, not -1"):
        Splatter().picture(scene, camera, -1)
    assert len(np.unique(Splatter().picture(scene, camera, 0).reshape(-1, 3), axis=0)) == 1  # the background alone
