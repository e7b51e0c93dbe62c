"""The page shows a camera's place as the camera filmed it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from streamlod.core.render.splatter import Splatter
from streamlod.core.scene.exposures import NEUTRAL, CameraExposure
from streamlod.core.scene.metadata import Metadata
from tests.client.web.miniserver import Behaviour, create_app, make_clip, serving
from tests.client.web.scenes import make_scene
from tests.client.web.watching import comes_to_show, psnr, reference, shows

pytestmark = pytest.mark.browser

EXPOSURES = (CameraExposure((1.4, 1.2, 1.0), (0.05, 0.0, 0.02)), NEUTRAL, NEUTRAL, NEUTRAL, CameraExposure((0.5,) * 3))


def test_a_cameras_place_is_shown_at_its_exposure(page: Any) -> None:
    scene = replace(make_scene(), metadata=Metadata(exposures=EXPOSURES))
    with serving(create_app(make_clip(scene, 2), Behaviour(newest=0))) as url:
        page.goto(f"{url}/?ui=0&quality=high")
        shows(page, "s.version === 0")
        for number in (0, 1, 4):
            camera = scene.header.cameras[number]
            page.evaluate(f"streamlod.setCamera({number})")
            expected = Splatter().picture(scene, camera) / 255
            comes_to_show(page, expected)
            neutral = psnr(expected, reference(scene, camera))
            assert (neutral < 30) == (number != 1), "the exposure can be told from the neutral picture"
