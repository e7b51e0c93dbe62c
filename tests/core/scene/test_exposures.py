"""Exposure by viewpoint: a camera's own at the camera, blended between two, neutral far from all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe
from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.render.splatter import Splatter
from streamlod.core.scene.exposures import NEUTRAL, CameraExposure, exposure_at
from streamlod.core.scene.metadata import Metadata
from tests.client.web.scenes import make_scene

BRIGHT = CameraExposure((1.5, 1.4, 1.3), (0.02, 0.0, -0.02))
DARK = CameraExposure((0.5, 0.6, 0.7), (-0.02, 0.0, 0.02))


def camera_at(x: float) -> Camera:
    eye = np.array([x, 0.0, -4.0])
    return pinhole(
        f"{x}", (40, 40), (24, 16), (48, 32), look_at(eye, eye + np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0]))
    )


def test_a_camera_is_shown_as_it_filmed_and_half_of_two_between_them() -> None:
    cameras, exposures = [camera_at(0), camera_at(2), camera_at(5)], (BRIGHT, DARK, NEUTRAL)
    for camera, own in zip(cameras, exposures, strict=True):
        assert exposure_at(camera.centre, cameras, exposures) == own
    middle = exposure_at(np.array([1.0, 0.0, -4.0]), cameras, exposures)
    np.testing.assert_allclose(middle.gain, (1.0, 1.0, 1.0))
    np.testing.assert_allclose(middle.offset, (0.0, 0.0, 0.0), atol=1e-12)
    nearer = exposure_at(np.array([0.1, 0.0, -4.0]), cameras, exposures)
    assert 1.4 < nearer.gain[0] < 1.5


def test_far_from_all_cameras_and_where_nothing_is_known_the_light_is_neutral() -> None:
    cameras = [camera_at(0), camera_at(2)]
    assert exposure_at(np.array([0.0, 9.0, 0.0]), cameras, (BRIGHT, DARK)) == NEUTRAL
    assert exposure_at(cameras[0].centre, cameras, None) == NEUTRAL
    assert exposure_at(cameras[0].centre, cameras, (BRIGHT,)) == NEUTRAL  # of another rig


def test_cameras_at_one_place_share_their_exposures_and_one_alone_has_its_own() -> None:
    twins = [camera_at(0), camera_at(0), camera_at(2)]
    at = exposure_at(twins[0].centre, twins, (BRIGHT, DARK, NEUTRAL))
    np.testing.assert_allclose(at.gain, (1.0, 1.0, 1.0))
    assert exposure_at(np.array([7.0, 0.0, 0.0]), [camera_at(0)], (BRIGHT,)) == BRIGHT


@pytest.mark.parametrize("wrong", [{"gain": (0.0, 1.0, 1.0)}, {"gain": (65.0, 1, 1)}, {"offset": (0.0, np.nan, 0.0)}])
def test_what_no_camera_shows_is_refused(wrong: dict[str, tuple[float, float, float]]) -> None:
    with pytest.raises(ValueError, match="must be"):
        CameraExposure(**wrong)


def test_exposures_travel_with_a_keyframe_and_light_the_picture() -> None:
    plain = make_scene()
    exposures = (BRIGHT, DARK, NEUTRAL, NEUTRAL, NEUTRAL)
    decoder = SceneDecoder()
    decoder.push(encode_keyframe(replace(plain, metadata=Metadata(exposures=exposures)), time_ns=0))
    scene = decoder.scene
    assert scene is not None
    assert scene.metadata.exposures is not None
    for sent, found in zip(exposures, scene.metadata.exposures, strict=True):
        np.testing.assert_allclose([*found.gain, *found.offset], [*sent.gain, *sent.offset], rtol=1e-6)
    for camera, own in zip(plain.header.cameras, exposures, strict=True):
        neutral = Splatter().picture(plain, camera) / np.float32(255)
        shown = Splatter().picture(scene, camera)
        np.testing.assert_allclose(shown, 255 * np.clip(own.apply(neutral), 0, 1), atol=1.5)
