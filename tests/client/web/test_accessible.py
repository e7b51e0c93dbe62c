"""The page for everyone: axe-core's rules in each state and theme, the keyboard alone, reduced motion."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.watching import INSPECT, WAIT, shows

pytestmark = pytest.mark.browser

AXE = Path(__file__).parent / "node_modules" / "axe-core" / "axe.min.js"
RULES = """async (only) => {
  const { violations } = await axe.run(only ? { runOnly: only } : {});
  return violations.flatMap(({ id, nodes }) => nodes.map((node) => `${id}: ${node.target} ${node.failureSummary}`));
}"""

CONTROLS = "[...document.querySelectorAll('button, input, canvas')].filter((e) => e.checkVisibility()).map((e) => e.id)"
NEXT_FRAME = "new Promise((resolve) => requestAnimationFrame(() => resolve(streamlod.state.camera)))"


TEXTS = ("#status-text", "#stream-name", "#t-time", "#t-live-text", "#stats dt", "#stats dd", ".menu small", ".menu p")


def luminance(colour: tuple[float, ...]) -> float:
    """The luminance of an sRGB colour, 0 to 1 (WCAG 2.2, relative luminance)."""
    linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in (c / 255 for c in colour)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


COLOURS = """(names) => names.map((name) => {
  const found = document.querySelector(name), { left, top, right, bottom } = found.getBoundingClientRect();
  return [name, [left, top, right, bottom], getComputedStyle(found).color.match(/[0-9.]+/g).slice(0, 3).map(Number)];
})"""


def contrasts(page: Any, backdrop: str) -> dict[str, float]:
    """WCAG contrast of the texts that lie over the picture, were the picture all of one colour."""
    page.evaluate("""(colour) => {
      document.getElementById("canvas").style.visibility = "hidden";
      document.getElementById("stage").style.background = colour;
    }""", backdrop)  # fmt: skip
    for _ in range(20):  # texts move when the status changes: they must be where they were while the screen was taken
        before = page.evaluate(COLOURS, TEXTS)
        screen = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        if (texts := page.evaluate(COLOURS, TEXTS)) == before:
            break
    found = {}
    for name, box, ink in texts:
        area = screen.crop(box)
        ground = max(area.getcolors(area.width * area.height))[1]  # most of it
        dark, bright = sorted((luminance(ground), luminance(tuple(ink))))
        found[name] = (bright + 0.05) / (dark + 0.05)
    return found


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_texts_are_readable_on_any_picture(page: Any, clip: Clip, theme: str) -> None:
    """At least 4.5 : 1 over white, black and what lies between, live and with panels open."""
    page.emulate_media(color_scheme=theme, reduced_motion="reduce")
    page.set_viewport_size({"width": 900, "height": 600})
    with serving(create_app(clip, Behaviour(fps=2, streams=("main", "stage left")))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.phase === 'live' && s.version >= 1")
        page.click("#b-stats")
        page.click("#b-quality")
        for backdrop in ("white", "black", "#ff0", "#808080"):
            found = contrasts(page, backdrop)
            assert min(found.values()) >= 4.5, (backdrop, found)


def complaints(page: Any, only: str | None) -> list[str]:
    """What axe-core finds on the page as it is now, by one rule or by all."""
    return list(page.evaluate(RULES, only))


@pytest.mark.parametrize(("theme", "only"), [("dark", None), ("light", "color-contrast")])
def test_follows_the_rules_of_accessibility(page: Any, clip: Clip, theme: str, only: str | None) -> None:
    """WCAG rules that a machine can check, with every panel open once."""
    if not AXE.exists():
        pytest.skip("axe-core is not installed: npm install --prefix tests/client/web")
    page.emulate_media(color_scheme=theme, reduced_motion="reduce")
    page.add_init_script(path=AXE)
    page.set_viewport_size({"width": 900, "height": 600})
    behaviour = Behaviour(newest=6, streams=("main", "stage left"))
    with serving(create_app(clip, behaviour)) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 6")
        found = {"live": complaints(page, only)}
        page.click("#b-stats")
        found["statistics"] = complaints(page, only)
        for name in ("cameras", "quality"):
            page.click(f"#b-{name}")
            found[name] = complaints(page, only)
            page.keyboard.press("Escape")
        for name, opener in (("help", "#b-help"), ("streams", "#stream-name")):
            page.click(opener)
            page.locator(f"dialog#{name}[open]").wait_for(**WAIT)
            found[name] = complaints(page, only)
            page.keyboard.press("Escape")
    for state in (
        Behaviour(state="starting", progress=(0.4, "step 400 of 1000")),
        Behaviour(close=(4404, "no stream")),
    ):
        with serving(create_app(clip, state)) as url:
            page.goto(f"{url}/?quality=high")
            page.locator("#card-title", has_text="No such stream" if state.close else "Training").wait_for(**WAIT)
            found[state.state + str(state.close)] = complaints(page, only)
            page.goto("about:blank")  # it would go on to ask a server that is gone how many watch
    assert {name: lines for name, lines in found.items() if lines} == {}


def test_keyboard_reaches_everything(page: Any, clip: Clip) -> None:
    """Tab visits every control there is; menus open, move and close by keys and give the focus back."""
    page.set_viewport_size({"width": 900, "height": 600})
    with serving(create_app(clip, Behaviour(newest=6, streams=("main", "stage left")))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 6")
        wanted = page.evaluate(CONTROLS)
        seen = set()
        for _ in range(len(wanted) + 2):
            page.keyboard.press("Tab")
            seen.add(page.evaluate("document.activeElement.id"))
        assert set(wanted) <= seen
        page.keyboard.press("c")
        assert page.evaluate("document.activeElement.closest('#camera-menu') !== null")
        first = page.evaluate("document.activeElement.textContent")
        page.keyboard.press("ArrowDown")
        assert page.evaluate("document.activeElement.textContent") != first
        page.keyboard.press("Escape")
        assert page.evaluate("document.activeElement.id") == "b-cameras"
        page.focus("#t-play")
        page.keyboard.press("Space")
        shows(page, "s.phase === 'paused'")
        told = "document.getElementById('canvas').ariaDescription"
        page.wait_for_function(f"{told} === 'Paused, 0:00.2, seen from near cam02'", **WAIT)


def test_reduced_motion_is_honoured(page: Any, clip: Clip) -> None:
    """Views change at once, nothing pulses, letting go stops the orbit."""
    with serving(create_app(clip, Behaviour(newest=6))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 6")
        assert page.evaluate("document.getAnimations().length") == 0
        page.keyboard.press("1")
        at_once = page.evaluate(NEXT_FRAME)
        page.evaluate(INSPECT)  # answered after the question how far away the scene is, which changes the camera, too
        page.mouse.move(160, 120)
        page.mouse.down()
        page.mouse.move(220, 120, steps=3)
        page.mouse.up()
        after = page.evaluate("streamlod.state.camera")
        page.wait_for_timeout(300)
        assert page.evaluate("streamlod.state.camera") == after != at_once
