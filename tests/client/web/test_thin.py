"""The page in a Chromium without WebGL: the server draws, everything else is as ever."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from streamlod.core.render.splatter import Splatter
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Limits, Settings
from tests.client.web.conftest import TEST_FLAGS, Console, chromium_path
from tests.client.web.miniserver import Behaviour, Clip, create_app, make_clip, serving
from tests.client.web.scenes import make_scene
from tests.client.web.watching import WAIT, comes_to_show, eventually, picture, psnr, shows
from tests.server.conftest import Running, running

pytestmark = pytest.mark.browser
FRAMES = 30


@pytest.fixture(scope="module")
def clip() -> Clip:
    """A scene whose network does not see the view."""
    return make_clip(make_scene(400, view_dependent=False), FRAMES)


@pytest.fixture(scope="module")
def server(clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """The real server, at the end of a recorded clip."""
    recording = tmp_path_factory.mktemp("thin") / "clip.slod"
    clip.write(recording)
    with running(Settings(limits=Limits(thin_viewers=1)), StreamSpec(play=recording, loop=False)) as server:
        server.wait(lambda stream: stream["state"] == "ended")
        yield server


@pytest.fixture(scope="module")
def blind(chromium: Any) -> Iterator[Any]:
    """A Chromium without any 3D."""
    flags = [flag for flag in TEST_FLAGS if "swiftshader" not in flag]
    browser = chromium.browser_type.launch(executable_path=chromium_path(), args=[*flags, "--disable-3d-apis"])
    yield browser
    browser.close()


@pytest.fixture
def page(blind: Any) -> Iterator[Any]:
    """A page of the rig's picture size whose console must stay empty."""
    context = blind.new_context(viewport={"width": 320, "height": 240}, reduced_motion="reduce")
    page = context.new_page()
    page.complaints = Console(page)
    yield page
    context.close()
    assert page.complaints.lines == []


def drawn(page: Any, version: int, quality: int = 92) -> None:
    """Wait for a picture of that version and quality."""
    page.wait_for_function(
        "([v, q]) => window.drawn && drawn.version === v && drawn.drawn.quality >= q", arg=[version, quality], **WAIT
    )


def listen(page: Any) -> None:
    """Keep what is known of the newest picture in `drawn`."""
    page.evaluate("streamlod.on('picture', (p) => { window.drawn = p; }); 0")


def focuses(page: Any, before: str) -> None:
    """Double-click on the picture until something is hit: where the drag has led depends on what is known of depths."""
    for x, y in ((160, 150), (120, 120), (200, 120), (160, 90), (100, 150), (220, 150)):
        page.mouse.dblclick(x, y)
        for _ in range(20):
            if page.evaluate("streamlod.state.camera") != before:
                return
            page.wait_for_timeout(100)
    raise AssertionError("no double-click turned the camera")


def test_the_server_draws_the_same_picture_and_obeys(page: Any, server: Running, clip: Clip) -> None:
    """Pictures of rig cameras agree with the Python client's; orbit, seek, pause and focus work."""
    page.goto(f"{server.url}/?ui=0")
    shows(page, f"s.version === {FRAMES - 1} && s.phase === 'ended'")
    assert page.locator("#stage").get_attribute("data-thin") is not None
    listen(page)
    for version, number in ((FRAMES - 1, 1), (8, 3), (14, 0)):
        page.evaluate("window.drawn = null; 0")
        if version < FRAMES - 1:
            page.evaluate("streamlod.pause()")
            shows(page, "s.phase === 'paused'")
            page.evaluate(f"streamlod.seek({version})")
            shows(page, f"s.version === {version} && s.phase === 'paused'")
        page.evaluate(f"window.drawn = null; streamlod.setCamera({number})")
        drawn(page, version)
        scene = clip.states[version]
        expected = Splatter().picture(scene, scene.header.cameras[number]) / 255
        comes_to_show(page, expected)  # a finer picture of the place before may come in between
    home = page.evaluate("streamlod.state.camera")
    page.mouse.move(160, 120)
    page.mouse.down()
    page.evaluate("window.drawn = null; 0")
    page.mouse.move(220, 130, steps=4)
    page.mouse.up()
    drawn(page, 14)
    turned = page.evaluate("streamlod.state.camera")
    assert turned != home

    def turns_away() -> None:
        assert psnr(picture(page), expected) < 25

    eventually(turns_away)
    focuses(page, turned)
    page.keyboard.press("End")
    shows(page, f"s.version === {FRAMES - 1} && s.mode === 'live'")


# Versions of the pictures that are shown after a seek and before the one that it asks for.
SEEK = """async (version) => {
  const others = [];
  const shown = new Promise((resolve) => {
    const stop = streamlod.on("picture", (p) => p.version === version ? (stop(), resolve()) : others.push(p.version));
  });
  streamlod.seek(version);
  await shown;
  return others;
}"""


@pytest.mark.parametrize("prepare", ["streamlod.pause()", "streamlod.play()"])
def test_a_seek_shows_nothing_on_the_way(page: Any, server: Running, prepare: str) -> None:
    """Paused, and while it plays, no more is shown before the frame that is asked for than the picture in flight."""
    page.goto(f"{server.url}/?ui=0")
    shows(page, f"s.version === {FRAMES - 1} && s.phase === 'ended'")
    page.evaluate(prepare)
    for version in (3, 20, 8, 14, 2):
        assert len(page.evaluate(SEEK, version)) <= 1


def test_plays_from_where_it_was_sent(page: Any, server: Running) -> None:
    """Sent elsewhere and played at once, before any picture of that place came, it plays from there."""
    page.goto(f"{server.url}/?ui=0")
    shows(page, f"s.version === {FRAMES - 1} && s.phase === 'ended'")
    page.evaluate("streamlod.pause()")
    shows(page, "s.phase === 'paused'")
    page.evaluate("streamlod.seek(20)")
    shows(page, "s.version === 20 && s.phase === 'paused'")
    page.evaluate("window.seen = []; streamlod.on('picture', ({ version }) => seen.push(version)); 0")
    page.evaluate("streamlod.seek(3); streamlod.play()")
    shows(page, f"s.version === {FRAMES - 1}")
    played = [version for version in page.evaluate("seen") if version != 20]
    assert played[0] == 3
    assert played == sorted(played)


def test_says_that_the_server_is_full(page: Any, blind: Any, server: Running) -> None:
    """The second viewer hears why there is no picture, tries again, and gets the place when it is free."""
    with blind.new_context(viewport={"width": 320, "height": 240}) as context:
        other = context.new_page()
        other.goto(f"{server.url}/")
        shows(other, "s.version !== null")
        page.goto(f"{server.url}/")
        page.locator("#card-text", has_text="draws for 1 viewers already").wait_for(**WAIT)
    shows(page, f"s.version === {FRAMES - 1}")


def test_thin_on_request_and_back(chromium: Any, server: Running) -> None:
    """A browser that could draw lets the server do it when asked to, and takes it back from the menu."""
    with chromium.new_context(viewport={"width": 640, "height": 480}, reduced_motion="reduce") as context:
        page = context.new_page()
        console = Console(page)
        page.goto(f"{server.url}/?thin=1")
        shows(page, f"s.version === {FRAMES - 1} && s.splats === 0")
        page.locator("#b-quality").click()
        page.locator("#quality-menu button", has_text="Server draws").click()
        shows(page, f"s.version === {FRAMES - 1} && s.splats > 0")
    assert console.lines == []


def test_recordings_need_webgl(page: Any, server: Running) -> None:
    """Without a server that draws there is no picture, and the page says so."""
    page.goto(f"{server.url}/?src=/v1/streams/main/bitstream")
    page.locator("#card-title", has_text="This browser cannot show the scene").wait_for(**WAIT)


def test_what_is_no_picture_is_refused_and_asked_for_again(page: Any, clip: Clip) -> None:
    """A server that knows of no drawn pictures sends packets: the page says what is wrong, and goes on trying."""
    behaviour = Behaviour(newest=3)
    with serving(create_app(clip, behaviour)) as url:
        page.goto(f"{url}/?thin=1")
        # between two attempts alone: while one is under way the card has no button
        card = page.locator("#card", has_text="A picture of the server cannot be read")
        card.locator("#card-button", has_text="Try now").wait_for(**WAIT)
        eventually(lambda: _asked(behaviour, 3))
        page.goto("about:blank")
    page.complaints.forgive("WebSocket connection to")


def _asked(behaviour: Behaviour, times: int) -> None:
    assert len(behaviour.hellos) >= times
