"""The page in a hand: a sheet of tools, a hint, help without keys, a screen that stays on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.client.web.conftest import Console
from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.watching import KEEP_TOASTS, WAIT, said, shows

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


def tap(page: Any, control: str) -> None:
    """Tap on one at the bottom, which hides from a hand that rests unless it has the focus."""
    page.focus(control)
    page.tap(control)


def test_tools_hint_help_and_wake_lock(page: Any, clip: Clip) -> None:
    """All that a desktop offers is within a thumb's reach, and nothing speaks of keys."""
    page.add_init_script(WATCH_LOCK)
    page.add_init_script(KEEP_TOASTS)
    with serving(create_app(clip, Behaviour(fps=1))) as url:
        page.clock.install()
        page.goto(f"{url}/?quality=high")
        said(page, "software")
        shows(page, "s.version >= 1")
        page.clock.fast_forward(6000)
        said(page, "pinch to come closer")
        shows(page, "s.phase === 'live'")
        page.wait_for_function("locks.length === 1 && !locks[0].released && locks[0].kind === 'screen'", **WAIT)
        assert page.locator("#tools").is_hidden()
        assert page.locator("#t-loop").is_visible()
        page.evaluate("addEventListener('pointerdown', () => { window.awake = !document.body.matches('.idle'); })")
        page.touchscreen.tap(195, 200)  # controls come back for a hand
        page.wait_for_function("window.awake", **WAIT)
        tap(page, "#b-more")
        page.locator("#tools").wait_for(**WAIT)
        box = page.locator("#tools").bounding_box()
        assert box["y"] > 422, "the sheet comes from below"
        assert page.locator("#timeline").bounding_box()["y"] >= box["y"] + box["height"]
        page.tap("#b-cameras")
        page.locator("#camera-menu").wait_for(**WAIT)
        page.locator("#camera-menu button", has_text="cam01").tap()
        said(page, "cam01")
        page.touchscreen.tap(195, 150)  # closes menu and sheet
        page.locator("#camera-menu").wait_for(state="hidden", **WAIT)
        page.locator("#tools").wait_for(state="hidden", **WAIT)
        tap(page, "#b-more")
        page.tap("#b-help")
        page.locator("#help").wait_for(**WAIT)
        assert page.locator("#help kbd").first.is_hidden()
        assert not any(word in page.locator("#help").inner_text() for word in ("Wheel", "click", "Right"))
        page.tap("#help form button")
        page.locator("#tools").wait_for(state="hidden", **WAIT)
        tap(page, "#b-more")
        page.tap("#b-home")  # the scene is seen, not the sheet
        page.locator("#tools").wait_for(state="hidden", **WAIT)
        tap(page, "#t-play")
        page.wait_for_function("locks[0].released", **WAIT)
