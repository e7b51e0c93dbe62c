"""Other moments than the one that is shown: small over the timeline, marked on it; and what a camera sees."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.watching import KEEP_TOASTS, WAIT, picture, psnr, said, shows

pytestmark = pytest.mark.browser
FRAMES = 40


@pytest.fixture(scope="module")
def url(clip: Clip, recording: Path) -> Iterator[str]:
    """A server of the page and of a recording."""
    with serving(create_app(clip, Behaviour(), recording.parent)) as url:
        yield url


def paused_at(page: Any, version: int) -> None:
    """Go to a frame of a file that has been played."""
    page.evaluate(f"streamlod.pause(); streamlod.seek({version})")
    shows(page, f"s.version === {version} && s.phase === 'paused'")


def test_the_pointer_shows_the_moment_and_marks_lead_back(page: Any, url: str) -> None:
    """Over the timeline there is a picture of the moment under the pointer, the same that is seen after a click."""
    page.set_viewport_size({"width": 900, "height": 506})
    page.clock.install()
    page.goto(f"{url}/?src=files/clip.slod&quality=high&marks=4,rubbish,900")
    shows(page, f"s.version === {FRAMES - 1} && s.phase === 'ended'")
    paused_at(page, 0)
    page.mouse.move(400, 100)  # the timeline may have hidden before, and hears no pointer while it is
    box = page.locator("#t-scrub").bounding_box()
    x, y = box["x"] + 8 + (box["width"] - 16) * 20 / (FRAMES - 1), box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.locator("#t-peek-time", has_text="0:00.6").wait_for(**WAIT)
    canvas = page.locator("#t-peek canvas")
    canvas.wait_for(**WAIT)
    page.wait_for_function("document.querySelector('#t-peek canvas').width === 160", **WAIT)

    def small() -> np.ndarray:
        shot = Image.open(io.BytesIO(canvas.screenshot())).convert("RGB").resize((160, 90))
        return np.asarray(shot, np.float64) / 255

    def large() -> np.ndarray:
        shown = Image.fromarray(np.uint8(255 * picture(page)))
        return np.asarray(shown.resize((160, 90), Image.Resampling.BOX), np.float64) / 255

    first = large()
    page.mouse.click(x, y)
    shows(page, "s.version === 20")
    page.mouse.move(x - 1, y)
    sought, inside = large(), np.s_[12:-12, 12:-12]  # its corners are round
    limit = time.monotonic() + 60
    while psnr(small()[inside], sought[inside]) < psnr(small()[inside], first[inside]) + 3:
        assert time.monotonic() < limit
    page.mouse.move(x, y - 200)
    assert page.locator("#t-peek").is_hidden()
    page.clock.fast_forward(4000)
    page.locator("#t-peek canvas").wait_for(state="detached", **WAIT)  # and frees what it took

    marks = page.locator("#t-marks button")
    assert marks.count() == 2
    assert [mark.is_visible() for mark in marks.all()] == [True, False]
    page.keyboard.press("m")
    page.locator("#t-marks button[title='Mark at 0:00.6']").wait_for(**WAIT)
    page.locator("#t-marks button[title='Mark at 0:00.1']").click()
    shows(page, "s.version === 4")
    page.keyboard.press("m")
    assert page.locator("#t-marks button[title='Mark at 0:00.1']").count() == 0, "marked again it is unmarked"


def test_marks_are_named_on_the_bar(page: Any, url: str) -> None:
    """Keys that are typed into a name do nothing else, and Escape keeps the name before."""
    page.goto(f"{url}/?src=files/clip.slod&quality=high")
    shows(page, f"s.version === {FRAMES - 1} && s.phase === 'ended'")
    paused_at(page, 12)
    page.keyboard.press("m")
    (mark,) = page.locator("#t-marks button").all()
    mark.press("F2")
    page.keyboard.type("goal m")
    page.keyboard.press("Enter")
    named = page.locator("#t-marks button[title^='goal m, ']")
    named.wait_for(**WAIT)
    named.press("F2")
    page.keyboard.type("nothing")
    page.keyboard.press("Escape")
    named.wait_for(**WAIT)
    assert page.locator("#t-marks input").count() == 0
    assert page.locator("#t-marks button").count() == 1


def test_a_cameras_own_picture_beside_the_view(page: Any, clip: Clip) -> None:
    """Where the server shows pictures of its cameras, a camera's is beside the view from there, until it is closed."""
    page.set_viewport_size({"width": 900, "height": 506})
    jpeg = io.BytesIO()
    Image.new("RGB", (320, 240), (200, 30, 30)).save(jpeg, "JPEG")
    page.add_init_script(KEEP_TOASTS)
    behaviour = Behaviour(fps=1, camera_pictures={"cam01": jpeg.getvalue()})
    with serving(create_app(clip, behaviour)) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.phase === 'live' && s.viewers === 1 && s.version !== null")
        source = page.locator("#source")
        page.keyboard.press("1")
        said(page, "cam00")
        page.keyboard.press("2")
        source.wait_for(**WAIT)
        assert source.inner_text() == "cam01"
        shown = np.asarray(Image.open(io.BytesIO(page.locator("#source img").screenshot())).convert("RGB"))
        assert np.abs(shown[60:-60, 60:-60].reshape(-1, 3).mean(axis=0) - (200, 30, 30)).max() < 8
        asked: list[Any] = []

        def hold(route: Any) -> None:
            asked.append(route)

        page.route("**/cameras/cam01.jpg", hold)
        while not asked:  # the first may be held before `route` returns: waiting for the event would miss it
            page.wait_for_timeout(50)
        source.click()  # while the next picture is on its way
        source.wait_for(state="hidden", **WAIT)
        for route in asked:
            route.continue_()
        page.unroute("**/cameras/cam01.jpg")
        page.keyboard.press("2")
        source.wait_for(**WAIT)
        page.evaluate("streamlod.pause()")
        source.wait_for(state="hidden", **WAIT)  # it shows the present, the view does not any more
