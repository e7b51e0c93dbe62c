"""Moving through the scene in Chromium, by mouse and keys, and being moved."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.watching import (
    INSPECT,
    WAIT,
    shows,
)

pytestmark = pytest.mark.browser


def splat_in_the_middle(page: Any) -> tuple[int, int]:
    """The pixel near the middle of the picture that differs most from the background, which is its corner."""
    picture = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB")).astype(int)
    middle = picture[80:160, 100:220]
    row, column = np.unravel_index(np.abs(middle - picture[2, 2]).sum(axis=2).argmax(), middle.shape[:2])
    return 100 + int(column), 80 + int(row)


def test_orbit_keys_and_focus(page: Any, clip: Clip) -> None:
    """Dragging orbits around the target; keys walk; double-click turns to a surface; R comes back."""
    with serving(create_app(clip, Behaviour(newest=3))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 3")
        page.evaluate(INSPECT)  # answered after the question how far away the scene is
        poses = [page.evaluate("streamlod.state.camera")]
        page.mouse.move(160, 120)
        page.mouse.down()
        page.mouse.move(220, 130, steps=4)
        page.mouse.up()
        poses.append(page.evaluate("streamlod.state.camera"))
        # before walking, whose length depends on how fast pictures come; where splats are, a ray hits one
        page.mouse.dblclick(*splat_in_the_middle(page))
        page.wait_for_function("(before) => streamlod.state.camera !== before", arg=poses[-1], **WAIT)
        poses.append(page.evaluate("streamlod.state.camera"))
        page.keyboard.down("w")
        page.wait_for_function("(before) => streamlod.state.camera !== before", arg=poses[-1], **WAIT)
        page.keyboard.up("w")
        poses.append(page.evaluate("streamlod.state.camera"))
        page.mouse.wheel(0, 200)
        page.wait_for_function("(before) => streamlod.state.camera !== before", arg=poses[-1], **WAIT)
        assert len(set(poses)) == len(poses)
        page.keyboard.press("r")
        page.wait_for_function("(home) => streamlod.state.camera === home", arg=poses[0], **WAIT)


def test_a_flight_ends_when_the_viewer_is_led_elsewhere(page: Any, clip: Clip) -> None:
    """As by an embedding page, which would else be led back; the opening shot is such a flight."""
    place = "streamlod.state.camera.split(',').slice(0, 3).join()"
    with serving(create_app(clip, Behaviour(newest=3))) as url:
        page.goto(f"{url}/?sway=0&quality=high")
        shows(page, "s.version === 3")
        before = page.evaluate(place)
        page.keyboard.press("t")
        page.wait_for_function(f"(before) => {place} !== before", arg=before, **WAIT)
        page.evaluate("streamlod.setCamera(0)")
        led = page.evaluate(place)
        page.wait_for_timeout(500)
        assert page.evaluate(place) == led != before
