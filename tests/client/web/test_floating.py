"""The picture in a window of its own (Document Picture-in-Picture), and back."""

from __future__ import annotations

from typing import Any

import pytest

from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.watching import WAIT, shows

pytestmark = pytest.mark.browser

KEEP_AWAY = """() => {  // a tab that is hidden gets no frames
  window.own = requestAnimationFrame;
  window.requestAnimationFrame = () => 0;
  window.frames_drawn = 0;
  streamlod.on("frame", () => frames_drawn++);
}"""
PANE = "documentPictureInPicture.window"


def test_the_picture_goes_to_a_small_window_and_comes_back(page: Any, clip: Clip) -> None:
    """It moves on there without a frame of the page's own, hears keys, and is back once the window is closed."""
    page.set_viewport_size({"width": 900, "height": 500})
    with serving(create_app(clip, Behaviour(newest=9))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 9")
        page.click("#b-float")
        page.wait_for_function(f"{PANE}?.document.getElementById('canvas')", **WAIT)
        page.evaluate(KEEP_AWAY)
        page.evaluate("streamlod.setCamera(0)")
        page.wait_for_function("frames_drawn > 2", polling=100, **WAIT)
        page.evaluate(f"{PANE}.dispatchEvent(new KeyboardEvent('keydown', {{ key: ' ' }}))")
        page.wait_for_function("streamlod.state.mode === 'paused'", polling=100, **WAIT)
        page.evaluate("() => { window.requestAnimationFrame = own; }")
        assert page.locator("#b-float").get_attribute("aria-pressed") == "true"
        page.evaluate(f"{PANE}.close()")
        page.locator("#stage > #canvas").wait_for(**WAIT)
        before = page.evaluate("frames_drawn")
        page.wait_for_function("(before) => frames_drawn > before + 2", arg=before, **WAIT)
        assert page.locator("#b-float").get_attribute("aria-pressed") == "false"
