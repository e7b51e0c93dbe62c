"""Going back in time and on, in Chromium: seek, pause, step, play, and one right after the other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.client.web.miniserver import Behaviour, Clip, create_app, make_clip, serving
from tests.client.web.scenes import make_scene
from tests.client.web.watching import (
    INSPECT,
    WAIT,
    eventually,
    meets,
    shows,
)

pytestmark = pytest.mark.browser


def test_seek_pause_step_and_the_way_back(page: Any, clip: Clip) -> None:
    """A frame that is asked for is the frame that is shown, to the bit."""
    with serving(create_app(clip, Behaviour(fps=60))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 39")
        page.evaluate("streamlod.pause()")
        shows(page, "s.phase === 'paused'")
        for target in (12, 30, 5):
            page.evaluate(f"streamlod.seek({target})")
            shows(page, f"s.version === {target} && s.phase === 'paused'")
            digests = page.evaluate(INSPECT)["digests"]
            assert digests == [level.digest() for level in clip.states[target].levels]
        page.evaluate("streamlod.play()")
        shows(page, "s.version > 5")
        page.evaluate("streamlod.seek(5); streamlod.pause()")
        shows(page, "s.version === 5 && s.phase === 'paused'")
        page.keyboard.press(".")
        shows(page, "s.version === 6 && s.phase === 'paused'")
        page.keyboard.press(",")
        shows(page, "s.version === 5 && s.phase === 'paused'")
        with meets(page, "s.version > 6 && s.mode === 'replay'"):
            page.keyboard.press(" ")
        with meets(page, "s.version === 39 && s.phase === 'live'"):
            page.keyboard.press("End")


def test_plays_from_where_it_was_sent(page: Any, clip: Clip) -> None:
    """Sent elsewhere and played at once, before any picture of that place came, it plays from there."""
    behaviour = Behaviour(fps=20)
    with serving(create_app(clip, behaviour)) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 39")
        page.evaluate("streamlod.pause()")
        shows(page, "s.phase === 'paused'")
        page.evaluate("window.seen = []; streamlod.on('picture', ({ version }) => seen.push(version)); 0")
        behaviour.fps = 5  # so that no machine is busy for as long as sixteen frames take
        with meets(page, "s.version === 39 && s.phase === 'live'"):
            page.evaluate("streamlod.seek(4); streamlod.play()")
        played = [version for version in page.evaluate("seen") if version < 39]
        assert played == sorted(played)
        assert 4 <= played[0] < 20, "frames that came while the first was drawn may be left out"


def test_steps_back_from_live(page: Any) -> None:
    """A step back while live leads where it should, although the next frames of the live edge are on their way."""
    clip = make_clip(make_scene(400, view_dependent=False), 400)
    with serving(create_app(clip, Behaviour(fps=20))) as url:
        page.goto(f"{url}/?quality=high")
        target = 10
        for _ in range(15):
            shows(page, f"s.mode === 'live' && s.version > {target}")
            page.wait_for_timeout(200)
            target = page.evaluate("streamlod.step(-3), streamlod.state.position.version - 3")
            shows(page, f"s.phase === 'paused' && s.version === {target}")
            page.evaluate("streamlod.seek('live')")


def test_who_seeks_early_is_not_led_back_to_the_moment_of_a_link(page: Any, clip: Clip, recording: Path) -> None:
    """The bar is there before the first picture; what is sought on it then counts, not what the link named."""
    held: list[Any] = []

    def hold(route: Any) -> None:
        held.append(route)

    page.route("**/kernel.wasm", hold)  # nothing is decoded until it comes
    with serving(create_app(clip, Behaviour(), recording.parent)) as url:
        page.goto(f"{url}/?quality=high&src=files/clip.slod&t=3")
        shows(page, "s.window && s.version === null")
        page.evaluate("window.seen = []; streamlod.on('picture', ({ version }) => seen.push(version))")
        page.evaluate("streamlod.seek(7); streamlod.pause()")
        held[0].continue_()
        for version in (7, 9, 11):
            page.evaluate(f"streamlod.seek({version})")
            shows(page, f"s.version === {version} && s.phase === 'paused'")
        assert 3 not in page.evaluate("seen")
        page.goto(f"{url}/?quality=high&src=files/clip.slod&t=3")
        shows(page, "s.window && s.version === null")
        held[1].continue_()
        shows(page, "s.version === 3 && s.phase === 'paused'")


ON_THE_WAY = """([target, next, ...values]) => new Promise((resolve) => {
    const look = () => {
        const { mode, version } = streamlod.state;
        if (mode !== "replay" && version !== target) return requestAnimationFrame(look);
        streamlod[next](...values);
        resolve();
    };
    streamlod.seek(target);
    look();
})"""  # seek, and do the next thing as soon as the server has answered


def test_pause_then_seek_stays_paused_and_the_past_has_speed(page: Any, clip: Clip) -> None:
    """A seek right after a pause, not answered yet, does not play on; the past of a stream has speed."""
    behaviour = Behaviour(fps=10, newest=30)
    with serving(create_app(clip, behaviour)) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version >= 20")
        assert page.locator("#t-speed").is_hidden()
        page.evaluate("streamlod.pause(); streamlod.seek(5)")
        shows(page, "s.version === 5 && s.mode === 'paused'")
        page.wait_for_timeout(600)
        assert page.evaluate("[streamlod.state.version, streamlod.state.mode]") == [5, "paused"]
        page.evaluate(ON_THE_WAY, [8, "seek", 12])
        shows(page, "s.version === 12 && s.mode === 'paused'")
        page.evaluate(ON_THE_WAY, [7, "play"])
        shows(page, "s.version > 7 && s.version < 12 && s.mode === 'replay'")
        page.evaluate("streamlod.pause(); streamlod.seek(5)")
        shows(page, "s.version === 5 && s.mode === 'paused'")
        page.evaluate("streamlod.play()")
        page.locator("#t-speed").wait_for(**WAIT)
        page.evaluate("document.getElementById('t-speed').click()")
        eventually(lambda: _told_speed(behaviour))
        assert page.title() == "main · streamlod"


def _told_speed(behaviour: Behaviour) -> None:
    assert {"type": "set", "speed": 2} in behaviour.wishes
