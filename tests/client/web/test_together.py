"""Two people watch together: one presents, the other follows until it drags."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import EdgeSettings, Settings
from tests.client.web.conftest import Console
from tests.client.web.miniserver import make_clip
from tests.client.web.scenes import make_scene
from tests.client.web.watching import WAIT, shows
from tests.server.conftest import Running, running

pytestmark = pytest.mark.browser
CHIP = "document.getElementById('status-together').textContent"
PLACE = "streamlod.state.camera.split(',').slice(0, 9).map(Number)"


@pytest.fixture(scope="module")
def server(kernel: bytes, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """A minute at five frames a second, which the server plays to all at once."""
    clip = make_clip(make_scene(200), 300, frame_ns=200_000_000)
    path = tmp_path_factory.mktemp("together") / "clip.slod"
    clip.write(path)
    with running(Settings(together=True), StreamSpec(play=path, loop=True)) as server:
        yield server


@pytest.fixture
def pair(chromium: Any, server: Running) -> Iterator[tuple[Any, Any]]:
    """Two visitors who have a picture."""
    contexts = [chromium.new_context(viewport={"width": 900, "height": 500}, reduced_motion="reduce") for _ in range(2)]
    pages = [context.new_page() for context in contexts]
    consoles = [Console(page) for page in pages]
    for page in pages:
        page.goto(f"{server.url}/?together=1&sway=0&quality=high")
        shows(page, "s.version >= 0 && s.mode === 'live'")
    yield pages[0], pages[1]
    for context in contexts:
        context.close()
    assert [console.lines for console in consoles] == [[], []]


def says(page: Any, text: str) -> None:
    """Wait until the chip says so."""
    page.wait_for_function(f"{CHIP} === {text!r}", **WAIT)


def looks_from(page: Any, place: list[float]) -> None:
    """Wait until the page looks from that place in that direction."""
    page.wait_for_function(f"there => {PLACE}.every((x, i) => Math.abs(x - there[i]) < 2e-3)", arg=place, **WAIT)


def test_a_follower_looks_where_the_presenter_does_until_it_drags(pair: tuple[Any, Any]) -> None:
    presenter, follower = pair
    says(follower, "")
    presenter.locator("#b-together").click()
    says(presenter, "You present")
    says(follower, "Somebody presents")
    follower.locator("#b-together").click()
    says(follower, "Following, drag to leave")
    for camera in (0, 3):
        presenter.evaluate(f"streamlod.setCamera({camera})")
        looks_from(follower, presenter.evaluate(PLACE))

    presenter.evaluate("streamlod.pause()")
    shows(presenter, "s.mode === 'paused'")
    position = presenter.evaluate("streamlod.state.position")
    shows(follower, f"s.mode === 'paused' && s.version === {position['version']}")
    presenter.keyboard.press("End")
    shows(follower, "s.mode === 'live'")
    follower.locator("#status-viewers", has_text="2 watching").wait_for(**WAIT)

    follower.mouse.move(400, 250)
    follower.mouse.down()
    follower.mouse.move(480, 260, steps=4)
    follower.mouse.up()
    says(follower, "Somebody presents")
    own = follower.evaluate(PLACE)
    presenter.evaluate("streamlod.setCamera(1)")
    follower.keyboard.press("g")  # and again
    says(follower, "Following, drag to leave")
    looks_from(follower, presenter.evaluate(PLACE))
    assert follower.evaluate(PLACE) != own
    presenter.keyboard.press("g")
    says(presenter, "")
    says(follower, "")
    assert follower.locator("#b-together").get_attribute("aria-pressed") == "false"


def test_who_leaves_presents_no_more_and_another_may(pair: tuple[Any, Any]) -> None:
    first, second = pair
    first.locator("#b-together").click()
    says(second, "Somebody presents")
    first.goto("about:blank")
    says(second, "")
    second.locator("#b-together").click()
    says(second, "You present")


def test_who_watches_at_an_edge_presents_to_all(pair: tuple[Any, Any], page: Any, server: Running) -> None:
    """The button comes once the origin lets the edge."""
    settings = Settings(edge=EdgeSettings(origin=server.url, linger_seconds=0), together=True)
    with running(settings) as edge:
        edge.wait(lambda stream: stream.get("id") == "main")
        page.set_viewport_size({"width": 900, "height": 500})
        page.goto(f"{edge.url}/?together=1&sway=0&quality=high")
        page.locator("#b-together").click(**WAIT)
        says(page, "You present")
        follower = pair[0]
        says(follower, "Somebody presents")
        follower.locator("#b-together").click()
        page.evaluate("streamlod.setCamera(3)")
        looks_from(follower, page.evaluate(PLACE))
        assert page.evaluate(CHIP) == "You present"
        page.goto("about:blank")
        says(follower, "")


def test_a_server_that_does_not_offer_it_shows_no_button(page: Any, recording: Path) -> None:
    with running(Settings(), StreamSpec(play=recording, loop=True)) as plain:
        page.goto(f"{plain.url}/?together=1&sway=0")
        shows(page, "s.version >= 0")
        assert not page.locator("#b-together").is_visible()
        page.keyboard.press("g")
        assert page.evaluate(CHIP) == ""
        page.goto("about:blank")


KEEP_CHIPS = """
window.chips = [];
document.addEventListener("DOMContentLoaded", () => {
  const chip = document.getElementById("status-text"), note = () => chips.push(chip.textContent);
  if (chip) new MutationObserver(note).observe(chip, { childList: true, characterData: true, subtree: true });
});
"""


def test_frames_that_lie_seconds_apart_are_not_missed(page: Any, kernel: bytes, tmp_path: Path) -> None:
    """Of the first one nobody knows yet when the next will come."""
    make_clip(make_scene(200), 3, frame_ns=5_000_000_000).write(tmp_path / "clip.slod")
    page.add_init_script(KEEP_CHIPS)
    with running(Settings(together=True), StreamSpec(play=tmp_path / "clip.slod", loop=True)) as server:
        page.goto(f"{server.url}/?together=1&sway=0")
        shows(page, "s.version === 0")
        shows(page, "s.version === 1")
        assert "No new frames" not in page.evaluate("chips")
        page.goto("about:blank")
