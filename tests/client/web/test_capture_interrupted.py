"""What interrupts filming: the stream is away, the screen is locked, the phone is turned, the camera gives nothing."""

from __future__ import annotations

from typing import Any

import pytest

from streamlod.server.settings import Settings
from tests.client.web.phones import figure, filmed, opened, says
from tests.server.ingest.push.stage import HEIGHT, WIDTH, rig, stage

pytestmark = pytest.mark.browser


def test_filming_goes_on_after_the_stream_was_away(phone: Any) -> None:
    """The connection is made anew, and H.264 begins with a picture that needs none before it."""
    with filmed(phone, 5) as (found, page):
        found.dataset.close()
        says(page, "Trying again: the stream takes no pictures at present")
        with found.filming():
            says(page, "Filming as phone1")
            found.wait(10)
            assert figure(page, "Refused") == "0"


HIDDEN = """(hidden) => {
  Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
  document.dispatchEvent(new Event("visibilitychange"));
}"""


def test_filming_goes_on_by_itself_after_the_screen_was_locked(phone: Any) -> None:
    """Browsers pause the picture or take the camera away; who takes it while the page is seen keeps it."""
    with filmed(phone, 3) as (found, page):
        page.evaluate(HIDDEN, True)
        page.evaluate("document.getElementById('picture').pause()")
        says(page, "The camera gives no pictures")
        page.evaluate(HIDDEN, False)
        says(page, "Filming as phone1")
        found.wait(3)
        end = "document.getElementById('picture').srcObject.getTracks()[0].dispatchEvent(new Event('ended'))"
        page.evaluate(HIDDEN, True)
        page.evaluate(end)
        says(page, "The camera was taken away")
        page.evaluate(HIDDEN, False)
        says(page, "Filming as phone1")
        found.wait(3)
        page.evaluate(end)
        says(page, "The camera was taken away")
        page.evaluate(HIDDEN, True)
        page.evaluate(HIDDEN, False)
        says(page, "The camera was taken away")


NEXT_FIGURES = """() => new Promise((resolve) => {
  const figures = document.getElementById("figures");
  new MutationObserver(() => resolve(figures.innerText)).observe(figures, { childList: true });
})"""


def test_pictures_a_second_are_counted_while_the_page_is_seen(phone: Any) -> None:
    """A hidden page films little or nothing: it said that the camera gives too few pictures, or none are sent."""
    with filmed(phone, 3) as (_, page):
        assert "Mbit/s" in page.evaluate(NEXT_FIGURES) + page.evaluate(NEXT_FIGURES)
        page.evaluate(HIDDEN, True)
        page.evaluate("document.getElementById('picture').pause()")
        says(page, "The camera gives no pictures")
        page.evaluate(HIDDEN, False)
        assert "not known yet" in page.evaluate(NEXT_FIGURES)
        assert "Mbit/s" in page.evaluate(NEXT_FIGURES)


TURNED = """
const canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
window.turn = (width, height) => Object.assign(canvas, { width, height });
setInterval(() => { pen.fillStyle = `rgb(0 ${Date.now() % 200} 0)`; pen.fillRect(0, 0, 999, 999); }, 40);
navigator.mediaDevices.getUserMedia = async () => canvas.captureStream(25);
"""


def test_a_phone_that_is_turned_while_it_films_goes_on_when_it_is_turned_back(phone: Any) -> None:
    with stage(Settings(), rig((WIDTH, HEIGHT), 1)) as found, opened(phone, "about:blank") as page:
        page.add_init_script(TURNED)
        page.goto(found.page())
        page.evaluate(f"turn({WIDTH}, {HEIGHT})")
        says(page, "Ready to film")
        page.click("#film")
        says(page, "Filming as phone1")
        found.wait(3)
        page.evaluate(f"turn({HEIGHT}, {WIDTH})")
        says(page, "Turn the phone")
        page.evaluate(f"turn({WIDTH}, {HEIGHT})")
        says(page, "Filming as phone1")
        found.wait(3)
        assert figure(page, "Refused") == "0"


def test_a_camera_that_gives_nothing_any_more_is_told_of(phone: Any) -> None:
    """As of a phone whose screen is locked."""
    with filmed(phone, 3) as (_, page):
        page.evaluate("document.getElementById('picture').srcObject.getTracks()[0].stop()")
        says(page, "The camera gives no pictures")
