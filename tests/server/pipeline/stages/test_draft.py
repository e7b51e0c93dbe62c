"""A first picture within seconds: the right colours in the right places, small, and as the rig's viewers are told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from streamlod.codec.encoder import encode_keyframe
from streamlod.core.errors import InputError
from streamlod.core.frames import FrameSet
from streamlod.core.metrics import psnr
from streamlod.core.render.splatter import Splatter
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import preset
from streamlod.server.pipeline.stages.draft import draft_scene

SPEC = SyntheticSpec(kind="room", cameras=4, frames=1, width=160, height=90)


@pytest.mark.long
def test_a_draft_shows_every_camera_the_right_colours_in_the_right_places() -> None:
    dataset = open_synthetic(SPEC)
    frame = next(iter(dataset.frames()))
    scene = draft_scene(frame, dataset.cameras, preset("live"), dataset.fps, "cpu")
    assert scene.header.cameras == dataset.cameras
    assert len(encode_keyframe(scene, time_ns=0)) < 60_000
    for camera, picture in zip(dataset.cameras, frame.images, strict=True):
        assert psnr(Splatter().picture(scene, camera), picture) > 18  # a picture of its mean colour has 12


@pytest.mark.long
def test_cameras_that_are_missing_take_no_part_and_one_alone_gives_none() -> None:
    dataset = open_synthetic(SPEC)
    frame = next(iter(dataset.frames()))
    three = FrameSet(0, 0, frame.images, np.array([True, True, False, True]))
    scene = draft_scene(three, dataset.cameras, preset("live"), dataset.fps, "cpu")
    assert scene.header.cameras == dataset.cameras
    exposures = scene.metadata.exposures
    assert exposures is not None
    np.testing.assert_allclose(exposures[2].gain, 1, atol=0.01)  # the mean over the cameras is held
    one = replace(three, present=np.array([True, False, False, False]))
    with pytest.raises(InputError, match="at least two"):
        draft_scene(one, dataset.cameras, preset("live"), dataset.fps, "cpu")
