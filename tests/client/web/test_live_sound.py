"""Sound that comes with the pictures of a live stream, in Chromium, from a real server."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from streamlod.codec.container import SlodWriter
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.scene.residual import difference
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.client.web.scenes import make_scene
from tests.client.web.test_sound import CLICKS, LISTEN, WATCH, in_step
from tests.client.web.watching import WAIT, shows
from tests.codec.scenes import move
from tests.server.conftest import running
from tests.server.sounds import hear, pieces

pytestmark = [pytest.mark.browser, pytest.mark.long]
FRAMES, FRAME_NS = 300, 100_000_000
BEGIN_NS = 1_790_000_000_000_000_000  # pictures and sound carry the time of day, as those of cameras do


@pytest.fixture(scope="module")
def filmed(kernel: bytes, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a minute at ten pictures a second."""
    path = tmp_path_factory.mktemp("filmed") / "clip.slod"
    state = make_scene(60)
    with SlodWriter(path) as writer:
        writer.append(encode_keyframe(state, time_ns=BEGIN_NS, profile=0))
        for number in range(1, FRAMES):
            before, state = state, move(state, seed=number)
            writer.append(
                encode_residual(before, difference(before, state), time_ns=BEGIN_NS + number * FRAME_NS, profile=0)
            )
    return path


def test_live_sound_is_heard_when_its_pictures_are_seen(page: Any, filmed: Path) -> None:
    """It begins late, waits for a gesture, follows pause and seek, and is measured where it leaves the browser."""
    page.set_viewport_size({"width": 900, "height": 506})
    page.add_init_script(
        "window.Audio = class { constructor() { return (window.playing = document.createElement('audio')); } };"
    )
    with running(Settings(), StreamSpec(play=filmed, loop=True)) as server:
        page.goto(f"{server.url}/?quality=low&sway=0&together=1")
        shows(page, "s.version > 2")
        assert page.evaluate("streamlod.state.sound") is None
        hear(server, pieces(31.0, BEGIN_NS))
        shows(page, "s.sound !== null")
        assert not page.evaluate("streamlod.state.sound.on")
        page.locator("#t-sound").evaluate("button => button.click()")  # the controls may have hidden
        page.evaluate(WATCH)
        in_step(page)
        page.evaluate(LISTEN)
        in_time = f"""(begin) => {{
            const offs = ({CLICKS})(begin).map(Math.abs).sort((a, b) => a - b);
            return offs.length === 5 && offs[2] <= 40;
        }}"""
        try:
            page.wait_for_function(in_time, arg=0, **WAIT)
        except Exception as error:
            raise AssertionError(f"{page.evaluate(CLICKS, 0)}") from error
        page.evaluate("streamlod.pause()")
        shows(page, "s.phase === 'paused' && !s.sound.playing")
        page.evaluate("streamlod.seek(20)")
        page.evaluate("streamlod.play()")
        in_step(page)
        page.mouse.move(300, 300)  # controls hide from who does nothing
        page.locator("#t-sound").evaluate("button => button.click()")  # the controls may have hidden
        shows(page, "!s.sound.on && !s.sound.playing")
        page.goto("about:blank")
