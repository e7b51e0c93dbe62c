"""The page in a hand: a sheet of tools, a hint, help without keys, a screen that stays on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.client.web.conftest import Console
from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.test_browser import WAIT, shows

pytestmark = pytest.mark.browser

WATCH_LOCK = """
window.locks = [];
navigator.wakeLock.request = async (kind) => {
  const lock = { kind, released: false, release: async () => { lock.released = true; } };
  locks.push(lock);
  return lock;
};
"""


@pytest.fixture
def page(chromium: Any) -> Iterator[Any]:
    """A phone that is held upright."""
    size = {"width": 390, "height": 844}
    context = chromium.new_context(viewport=size, has_touch=True, is_mobile=True, reduced_motion="reduce")
    page = context.new_page()
    page.complaints = Console(page)
    yield page
    context.close()
    assert page.complaints.lines == []


def test_tools_hint_help_and_wake_lock(page: Any, clip: Clip) -> None:
    """All that a desktop offers is within a thumb's reach, and nothing speaks of keys."""
    page.add_init_script(WATCH_LOCK)
    with serving(create_app(clip, Behaviour(fps=2))) as url:
        page.clock.install()
        page.goto(f"{url}/?quality=high")
        page.locator("#toast", has_text="software").wait_for(**WAIT)
        shows(page, "s.version >= 1")
        page.clock.fast_forward(6000)
        page.locator("#toast", has_text="pinch to come closer").wait_for(**WAIT)
        shows(page, "s.phase === 'live'")
        page.wait_for_function("locks.length === 1 && !locks[0].released && locks[0].kind === 'screen'", **WAIT)
        assert page.locator("#tools").is_hidden()
        assert page.locator("#t-loop").is_visible()
        page.touchscreen.tap(195, 200)  # controls come back for a hand
        page.tap("#b-more")
        box = page.locator("#tools").bounding_box()
        assert box["y"] > 422, "the sheet comes from below"
        assert page.locator("#timeline").bounding_box()["y"] >= box["y"] + box["height"]
        page.tap("#b-cameras")
        assert page.locator("#camera-menu").is_visible()
        page.locator("#camera-menu button", has_text="cam01").tap()
        page.locator("#toast", has_text="cam01").wait_for(**WAIT)
        page.touchscreen.tap(195, 150)  # closes menu and sheet
        page.locator("#camera-menu").wait_for(state="hidden", **WAIT)
        page.locator("#tools").wait_for(state="hidden", **WAIT)
        page.tap("#b-more")
        page.tap("#b-help")
        assert page.locator("#help kbd").first.is_hidden()
        page.tap("#help form button")
        page.touchscreen.tap(195, 200)
        page.locator("#tools").wait_for(state="hidden", **WAIT)
        page.tap("#t-play")
        page.wait_for_function("locks[0].released", **WAIT)
