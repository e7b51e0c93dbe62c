"""Where a visit begins, how far it can go, and the way back."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.watching import INSPECT, KEEP_TOASTS, WAIT, picture, said, shows

pytestmark = pytest.mark.browser


def distance(page: Any) -> float:
    """From the camera to the point that it orbits around."""
    return float(page.evaluate("streamlod.state.camera").split(",")[9])


def test_begins_at_what_the_rig_looks_at(page: Any, clip: Clip) -> None:
    """Every load finds the same point to orbit around: the question waits for the first splats."""
    scene = clip.states[3]
    middle = scene.header.cameras[2]
    depths = []
    for number, level in enumerate(scene.levels):
        steps = float(scene.header.position_steps[number])
        points = scene.header.octree.node_of(level.voxel, number) + level.position * steps
        seen = points @ middle.world_to_camera[:3, :3].T + middle.world_to_camera[:3, 3]
        squared = (seen**2).sum(axis=1)
        depths += list(seen[(seen[:, 2] > 0) & (squared < 1.1 * seen[:, 2] ** 2), 2])
    with serving(create_app(clip, Behaviour(newest=3))) as url:
        for _ in range(3):
            page.goto(f"{url}/?quality=high")
            shows(page, "s.version === 3")
            page.evaluate(INSPECT)  # answered after the question how far away the scene is
            assert distance(page) == pytest.approx(np.median(depths), rel=0.02)


EARLY = """
const { defineProperty } = Object;
Object.defineProperty = (target, name, what) => {
  if (name === "streamlod") what.value.on("scene", () => what.value.setCamera(0)); // before there are splats
  return defineProperty(target, name, what);
};
"""


def test_the_pivot_is_what_a_camera_looks_at_however_early_it_is_chosen(page: Any, clip: Clip) -> None:
    """A camera that is chosen before the first splats exist is orbited about what it looks at once they do."""
    with serving(create_app(clip, Behaviour(newest=3))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 3")
        page.evaluate(INSPECT)
        page.evaluate("streamlod.setCamera(0)")
        page.evaluate(INSPECT)
        known = page.evaluate("streamlod.state.camera")
        page.add_init_script(EARLY)
        page.reload()
        shows(page, "s.version === 3")
        page.evaluate(INSPECT)
        assert page.evaluate("streamlod.state.camera") == known
        assert distance(page) != 3


def test_a_narrow_screen_frames_the_subject(page: Any, clip: Clip) -> None:
    """Upright phones fill three fifths of their height; a button shows all that the camera sees from left to right."""

    def knots() -> tuple[float, float]:
        """Parts of the width and of the height above the middle that the knots take."""
        mask = np.abs(picture(page) - (0.08, 0.09, 0.12)).max(axis=2) > 0.15
        above = mask[: len(mask) * 9 // 20]
        return above.any(axis=0).mean(), above.any(axis=1).mean()

    page.set_viewport_size({"width": 240, "height": 520})
    with serving(create_app(clip, Behaviour(newest=3))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 3")
        page.evaluate(INSPECT)
        filled = knots()
        page.click("#b-more")
        page.click("#b-whole")
        page.wait_for_timeout(300)
        whole = knots()
        page.set_viewport_size({"width": 320, "height": 240})
        page.wait_for_timeout(300)
        wide = knots()
        page.locator("#b-whole").wait_for(state="hidden", **WAIT)
    assert whole[0] == pytest.approx(wide[0], abs=0.15), "the knots take the same part of the width"
    assert filled[1] > 1.5 * whole[1], "they are larger by default"


def screen(page: Any) -> Image.Image:
    """What is on the screen, not only on the canvas."""
    return Image.open(io.BytesIO(page.screenshot())).convert("RGB")


def test_fades_outside_and_offers_a_way_back(page: Any, clip: Clip) -> None:
    """Far away and behind the scene the picture fades, nobody gets lost, and a button leads back."""
    with serving(create_app(clip, Behaviour(newest=3))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 3")
        page.evaluate(INSPECT)
        home = page.evaluate("streamlod.state.camera")
        assert page.locator("#b-back").is_hidden()
        page.mouse.move(160, 120)
        for _ in range(30):
            page.mouse.wheel(0, 400)
        page.locator("#b-back").wait_for(**WAIT)
        position = np.array(page.evaluate("streamlod.state.camera").split(",")[:3], float)
        assert np.linalg.norm(position) < 20, "it goes no farther"
        assert "blur" in page.evaluate("haze.style.backdropFilter")
        background = [255 * x for x in clip.states[3].header.background]
        assert screen(page).getpixel((0, 120)) == pytest.approx(background, abs=6), "the page does not shine through"
        page.click("#b-back")
        page.wait_for_function("(home) => streamlod.state.camera === home", arg=home, **WAIT)
        page.locator("#b-back").wait_for(state="hidden", **WAIT)
        assert page.evaluate("haze.style.backdropFilter") == ""


def test_the_rigs_cameras_are_named_and_lead_there(page: Any, clip: Clip) -> None:
    """With the rig shown, each camera has its name in the picture; a click goes there."""
    page.set_viewport_size({"width": 900, "height": 600})
    page.add_init_script(KEEP_TOASTS)
    with serving(create_app(clip, Behaviour(newest=3))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 3")
        page.evaluate(INSPECT)
        page.click("#b-cameras")
        page.locator("#camera-menu button", has_text="Show the rig").click()
        page.mouse.move(450, 300)
        page.mouse.wheel(0, 400)
        name = page.locator("#rig button", has_text="cam01")
        name.wait_for(**WAIT)
        name.click()
        said(page, "cam01")
        eye = clip.states[3].header.cameras[1].centre
        at = "streamlod.state.camera.split(',').slice(0, 3).map(Number)"
        page.wait_for_function(f"(eye) => Math.hypot(...{at}.map((x, i) => x - eye[i])) < 0.01", arg=list(eye), **WAIT)


def test_swings_slowly_when_nobody_touches_it(chromium: Any, clip: Clip) -> None:
    """After a while without a hand the view begins to move by itself, and stops for one."""
    with (
        chromium.new_context(viewport={"width": 320, "height": 240}, reduced_motion="no-preference") as context,
        serving(create_app(clip, Behaviour(fps=2))) as url,
    ):
        page = context.new_page()
        page.clock.install()
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version >= 1")
        page.evaluate(INSPECT)
        page.mouse.move(50, 50)  # nobody has touched it from here on
        before = page.evaluate("streamlod.state.camera")
        page.clock.fast_forward(4000)
        page.wait_for_function("document.body.classList.contains('idle')", **WAIT)
        page.wait_for_timeout(300)
        assert page.evaluate("streamlod.state.camera") == before, "it does not begin as soon as the controls hide"
        page.clock.fast_forward(8000)
        page.wait_for_function("(before) => streamlod.state.camera !== before", arg=before, **WAIT)
        page.mouse.move(100, 100)
        page.mouse.move(110, 100)
        page.wait_for_timeout(300)
        stopped = page.evaluate("streamlod.state.camera")
        page.wait_for_timeout(600)
        assert page.evaluate("streamlod.state.camera") == stopped
