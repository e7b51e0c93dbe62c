"""The page in a real headless Chromium, against a small server: pictures, state, faults, words; and the real server."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.test_modules import assert_same_splats
from tests.client.web.watching import (
    COUNT_OBJECTS,
    INSPECT,
    WAIT,
    amid_the_scene,
    comes_to_show,
    meets,
    reference,
    shows,
)

pytestmark = pytest.mark.browser


def test_same_picture_splats_and_state_as_python(page: Any, clip: Clip) -> None:
    """The picture of every rig camera, the splats and the integer state are those of the Python side."""
    with serving(create_app(clip, Behaviour(newest=7))) as url:
        page.goto(f"{url}/?ui=0&quality=high")
        shows(page, "s.version === 7")
        scene = clip.states[7]
        for number in (0, 2, 4):
            camera = scene.header.cameras[number]
            page.evaluate(f"streamlod.setCamera({number})")
            comes_to_show(page, reference(scene, camera))
        # Amid the scene much lies far beside the picture, or nearer than any camera has seen it.
        page.evaluate("streamlod.setCamera('0.1,-0.3,-0.4, 0,0,1, 0,1,0, 1, 1.25, 0,0, 1')")
        comes_to_show(page, reference(scene, amid_the_scene(page)))
        page.evaluate("streamlod.setCamera(4)")
        page.evaluate(INSPECT)  # may be answered before splats are made for the new view, which the next is not
        state = page.evaluate(INSPECT)
    assert state["digests"] == [level.digest() for level in scene.levels]
    splats = np.array(state["splats"], np.uint32).view(np.float32).reshape(-1, 12)
    assert_same_splats(splats, scene, scene.header.cameras[4].centre)


def test_corrupt_packet_is_refused_and_mended(page: Any, clip: Clip) -> None:
    """A damaged packet changes nothing; the page asks anew and is right again."""
    behaviour = Behaviour(fps=60, corrupt={9}, newest=8)
    with serving(create_app(clip, behaviour)) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 8")
        page.evaluate("window.refused = []; streamlod.on('refused', (r) => refused.push(r.code)); 0")
        behaviour.newest = 9
        shows(page, "s.version === 9")
        with meets(page, "s.version === 14 && s.phase === 'live'"):
            behaviour.newest = 14
        assert page.evaluate("refused") == ["bad_checksum"]
        assert len(behaviour.hellos) == 2
        assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[14].levels]


DESTROY_AMID_PICTURES = """() => {
  const end = performance.now() + 200;
  while (performance.now() < end); // pictures of the worker queue up meanwhile
  streamlod.destroy();
  return new Promise((done) => setTimeout(done, 100)); // drawing them with what was freed would fill the console
}"""


def test_frees_the_graphics_card(page: Any, clip: Clip) -> None:
    """Frames create no objects, and destroy() deletes all."""
    page.add_init_script(COUNT_OBJECTS)
    with serving(create_app(clip, Behaviour(fps=20))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version >= 1")
        before = page.evaluate("({ ...objects })")
        shows(page, "s.version >= 15")
        assert page.evaluate("({ ...objects })") == before
        page.evaluate(DESTROY_AMID_PICTURES)
        assert set(page.evaluate("Object.values(objects)")) == {0}


def test_says_what_is_going_on(page: Any, clip: Clip) -> None:
    """A card explains why there is no picture."""
    for behaviour, title in (
        (Behaviour(state="starting", progress=(0.4, "step 400 of 1000")), "Training the first frame"),
        (Behaviour(state="idle"), "Waiting for the first frame"),
        (Behaviour(version=2), "This page is out of date"),
        (Behaviour(close=(4401, "token missing")), "You may not watch this stream"),
        (Behaviour(close=(4404, "no stream main")), "No such stream"),
    ):
        with serving(create_app(clip, behaviour)) as url:
            page.goto(f"{url}/?quality=high")
            page.locator("#card-title", has_text=title).wait_for(**WAIT)
            page.goto("about:blank")  # it would go on to ask a server that is gone how many watch
    page.complaints.forgive("WebSocket connection to")  # of pages that were left


def test_a_token_is_entered_where_none_was_given(page: Any, clip: Clip) -> None:
    """In the card, as frames of other pages may ask nothing; its letters are no commands."""
    behaviour = Behaviour(close=(4401, "token missing"))
    with serving(create_app(clip, behaviour)) as url:
        page.goto(f"{url}/?quality=high")
        page.locator("#card-button").click(**WAIT)
        page.keyboard.type("hic")
        assert page.locator("#stats").is_hidden()
        assert page.locator("#camera-menu").is_hidden()
        behaviour.close = None
        page.keyboard.press("Enter")
        shows(page, "s.version > 0")
        assert "token=hic" in page.url
        assert page.locator("#card-token").is_hidden()


def test_says_when_there_is_no_webgl(page: Any, clip: Clip) -> None:
    """No WebGL2, no exception."""
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    with serving(create_app(clip, Behaviour())) as url:
        page.goto(f"{url}/?quality=high")
        page.locator("#card-title", has_text="This browser cannot show the scene").wait_for(**WAIT)


def test_embedding_page_hears_and_commands(page: Any, clip: Clip, tmp_path: Path) -> None:
    """An iframe tells its state and obeys seek."""
    with serving(create_app(clip, Behaviour(newest=8), tmp_path)) as url:
        (tmp_path / "host.html").write_text(
            "<link rel=icon href=/favicon.svg><script>heard = {}; addEventListener('message', (e) => "
            "heard[e.data.streamlod === 'event' ? e.data.event : 'answer'] = e.data)</script>"
            f"<iframe src='{url}/?embed=1&ui=0' width=300 height=200></iframe>"
        )
        page.goto(f"{url}/files/host.html")
        page.wait_for_function("heard.picture?.state.version === 8", **WAIT)
        command = {"streamlod": "seek", "id": 5, "arguments": [2]}
        page.evaluate("(command) => frames[0].postMessage(command, '*')", command)
        page.wait_for_function("heard.answer?.id === 5 && heard.status?.state.position.version >= 2", **WAIT)


def test_real_server_live_seek_restart(page: Any, clip: Clip, recording: Path) -> None:
    """The real server plays a file: the page follows it to its end, seeks in the window, steps, and goes on."""
    from streamlod.server.pipeline.spec import StreamSpec
    from streamlod.server.settings import Settings
    from tests.server.conftest import running

    with running(Settings(), StreamSpec(play=recording, loop=False)) as server:
        page.goto(f"{server.url}/?quality=high&together=1")
        shows(page, "s.version === 39")
        assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[39].levels]
        page.evaluate("streamlod.pause()")
        shows(page, "s.mode === 'paused'")
        for target in (11, 25):
            page.evaluate(f"streamlod.seek({target})")
            shows(page, f"s.version === {target} && s.phase === 'paused'")
            assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[target].levels]
        page.keyboard.press(" ")
        shows(page, "s.version > 26")
        page.keyboard.press("End")
        shows(page, "s.version === 39 && s.mode === 'live'")
        page.goto(f"{server.url}/?quality=high&src=/v1/streams/main/bitstream")
        shows(page, "s.version === 39 && s.phase === 'ended'")
        page.evaluate("streamlod.seek(21)")
        shows(page, "s.version === 21 && s.phase === 'paused'")
        assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[21].levels]
