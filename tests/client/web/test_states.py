"""What the page says about what is seen: live only when it is, and never a word that contradicts the picture."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest

from streamlod.codec.container import SlodWriter
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from streamlod.server.worker.ingest_report import complaint
from tests.attack.test_rights import write_tokens
from tests.client.web.miniserver import Behaviour, Clip, create_app, make_clip, serving
from tests.client.web.scenes import make_scene
from tests.client.web.watching import INSPECT, WAIT, comes_to_show, picture, shows
from tests.server.conftest import make_clip as write_clip
from tests.server.conftest import running
from tests.server.large_clip import COUNTS

pytestmark = pytest.mark.browser

OPACITY = "getComputedStyle(document.getElementById('{}')).opacity"
COLOUR = "getComputedStyle(document.querySelector('#t-live')).color"
RED = "rgb(255, 122, 122)"
KEEP_TITLES = """
window.titles = [];
document.addEventListener("DOMContentLoaded", () => {
  const card = document.getElementById("card"), title = document.getElementById("card-title");
  const note = () => card.hidden || titles.push(title.textContent);
  new MutationObserver(note).observe(card, { attributes: true, subtree: true, childList: true });
});
"""

# Phases up to the first "replay", and versions that were decoded, drawn or not.
KEEP_HISTORY = """
window.phases = [];
window.versions = [];
const { defineProperty } = Object;
Object.defineProperty = (target, name, what) => {
  if (name === "streamlod") what.value.on("status", () => {
    const { phase, position } = what.value.state;
    if (phases.at(-1) !== phase && !phases.includes("replay")) phases.push(phase);
    if (position) versions.push(position.version);
  });
  return defineProperty(target, name, what);
};
"""


@pytest.fixture(scope="module")
def clip() -> Clip:
    """A minute at five frames a second."""
    clip = make_clip(make_scene(300), 300)
    clip.key()
    clip.residual(0, 1)
    return clip


def chip(page: Any, text: str) -> None:
    """Wait until the chip says `text`."""
    page.locator("#status-text", has_text=text).wait_for(**WAIT)


def test_live_is_red_only_while_it_is(page: Any, clip: Clip) -> None:
    """Cameras at the newest frame: red. Paused, or far behind, or silent: not."""
    page.emulate_media(color_scheme="dark", reduced_motion="reduce")
    behaviour = Behaviour(fps=5)
    with serving(create_app(clip, behaviour)) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, f"s.version >= 1 && s.phase === 'live' && {COLOUR} === '{RED}'")
        page.evaluate("streamlod.pause()")
        chip(page, "Paused")
        assert page.evaluate(COLOUR) != RED
        page.evaluate("streamlod.seek(0); streamlod.play()")
        chip(page, "behind live")
        assert page.evaluate(COLOUR) != RED
        page.keyboard.press("End")
        shows(page, f"s.phase === 'live' && {COLOUR} === '{RED}'")
        behaviour.newest = 1
        chip(page, "No new frames")
        assert page.evaluate(COLOUR) != RED
        behaviour.newest, behaviour.leave = None, (1000, "the stream was deleted")
        chip(page, "Deleted, this is its last picture")
        assert page.evaluate("streamlod.state.phase") == "deleted"
        assert page.locator("#card").is_hidden()
        page.goto("about:blank")  # it would go on to ask a server that is gone how many watch


def test_pictures_taken_earlier_are_not_called_live(page: Any, clip: Clip) -> None:
    """A stream that is trained from a data set is at its newest frame, in green."""
    page.emulate_media(color_scheme="dark", reduced_motion="reduce")
    with serving(create_app(clip, Behaviour(fps=5, source="data", viewers=3))) as url:
        page.goto(f"{url}/?quality=high")
        chip(page, "Newest frame")
        page.locator("#status-viewers", has_text="3 watching").wait_for(**WAIT)
        assert page.evaluate("streamlod.state.viewers") == 3
        assert page.locator("#t-live").inner_text() == "NEWEST"
        assert page.evaluate(COLOUR) != RED


def minutes_pass(page: Any) -> None:
    """By the page's clock, in which it would ask twenty times who watches: every ten seconds."""
    for _ in range(20):
        page.clock.fast_forward(10_000)
        page.evaluate("fetch('favicon.svg', { cache: 'no-store' }).then((answer) => answer.text())")  # time to be told


def test_who_may_not_watch_any_more_does_not_go_on_asking(page: Any, clip: Clip) -> None:
    """A token that ends while a page is open: each question with it would count against all who share its address."""
    page.clock.install()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    behaviour = Behaviour(fps=5)
    with serving(create_app(clip, behaviour)) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.phase === 'live'")
        behaviour.leave = (4401, "the token has expired or was withdrawn; connect with another")
        shows(page, "s.phase === 'denied'")
        asked.clear()
        minutes_pass(page)
        assert len([url for url in asked if "favicon" not in url]) <= 1, "one may have been on its way"


def test_a_token_that_runs_out_while_a_file_plays(page: Any, tmp_path: Path) -> None:
    """What is here plays on, and nobody asks again and again: a server counts that. Then another token is asked for."""
    page.clock.install()
    settings = write_tokens(tmp_path, old={"rights": ["read"]}, new={"rights": ["read"]})
    clip = write_clip(tmp_path / "clip.slod", 12, COUNTS, 1, frame_ns=1_000_000_000)  # too large to be loaded at once
    with running(settings, StreamSpec(play=clip.path)) as server:
        asked: list[str] = []
        page.on("response", lambda answer: asked.append(answer.url) if answer.status == 401 else None)
        page.goto(f"{server.url}/?token=old")
        shows(page, "s.phase === 'replay' && s.version !== null")
        page.evaluate("streamlod.pause()")
        write_tokens(tmp_path, new={"rights": ["read"]})
        server.registry.gate.reload()
        with page.expect_response(lambda answer: answer.status == 401):
            page.clock.fast_forward(10_000)
        minutes_pass(page)
        assert len(asked) == 1
        page.evaluate("streamlod.play()")
        shows(page, "s.phase === 'denied'")
        assert "a valid token is needed" in page.inner_text("#card-text")
        page.fill("#card-token", "new")
        page.click("#card-button")
        shows(page, "s.phase === 'replay' && s.version !== null")
        page.goto("about:blank")
    page.complaints.forgive("status of 401")


def test_the_chip_wakes_when_something_is_wrong(page: Any, clip: Clip) -> None:
    """Controls hide from a hand that rests, but a picture that froze is said aloud."""
    page.remove_locator_handler(page.locator("body.idle"))  # no hand comes
    behaviour = Behaviour(fps=5)
    with serving(create_app(clip, behaviour)) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.phase === 'live'")
        behaviour.newest = 1
        page.wait_for_function("document.body.classList.contains('idle')", **WAIT)
        chip(page, "No new frames")
        assert page.evaluate(OPACITY.format("identity")) == "1"
        assert page.evaluate(OPACITY.format("tools")) == "0"


def test_latency_from_camera_to_screen(page: Any) -> None:
    """Frames are filmed 400 ms before the server has them: the chip says a little more than that."""
    minute = make_clip(make_scene(300), 1800)
    with serving(create_app(minute, Behaviour(fps=30, lead_ns=400_000_000))) as url:
        page.goto(f"{url}/?quality=high")
        said = "/^[0-9.]+ s$/.test(document.getElementById('status-latency').textContent)"
        shows(page, f"350 <= s.latencyMs && s.latencyMs < 5000 && {said}")


def test_the_delay_of_a_slowly_trained_stream_is_true_and_counts_up(page: Any) -> None:
    """One frame in two seconds is trained, three seconds after it was filmed: the page's times are those of filming."""
    slow = make_clip(make_scene(300), 400, frame_ns=2_000_000_000)
    with serving(create_app(slow, Behaviour(fps=0.5, lead_ns=5_000_000_000))) as url:
        page.goto(f"{url}/?quality=high&sway=0")
        shows(page, "s.phase === 'live' && s.latencyMs !== null && s.version >= 2")
        seen = page.evaluate(
            """async () => {
              const seen = [], { streamlod } = window, begin = performance.now();
              while (performance.now() - begin < 5000) {
                const { version, latencyMs, behindSeconds, phase } = streamlod.state;
                seen.push([version, latencyMs, behindSeconds, phase, performance.now()]);
                await new Promise((resolve) => setTimeout(resolve, 100));
              }
              return seen;
            }"""
        )
    for (version, delay, _, _, at), (later_version, later_delay, _, _, later) in itertools.pairwise(seen):
        if version == later_version:
            assert abs((later_delay - delay) - (later - at)) < 50, "it counts up until the next picture"
    assert {phase for *_, phase, _ in seen} <= {"live", "stalled"}
    assert len({version for version, *_ in seen}) >= 2
    assert min(delay for _, delay, *_ in seen) >= 2500
    assert max(behind for _, _, behind, *_ in seen) <= 2.0
    assert page.locator("#t-time").inner_text().startswith("0:")


def test_no_word_of_the_end_before_the_picture(page: Any, clip: Clip) -> None:
    """Who joins a stream that has ended sees its last frame, without a card about the end in between."""
    page.add_init_script(KEEP_TITLES)
    with serving(create_app(clip, Behaviour(state="ended", newest=6))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 6 && s.phase === 'ended'")
        chip(page, "Ended")
        assert set(page.evaluate("titles")) <= {"Connecting", "Loading"}


def test_a_played_file_is_a_replay_that_can_be_sought(page: Any, clip: Clip, tmp_path: Path) -> None:
    """`serve --play`: all of the file can be sought at once, it loops, and nobody calls it live."""
    recording = tmp_path / "clip.slod"
    with SlodWriter(recording) as writer:
        writer.append(clip.key())
        for version in range(1, 40):  # the clip goes on for longer
            writer.append(clip.residual(version - 1, version))
    page.add_init_script(KEEP_HISTORY)
    with running(Settings(on_demand_seconds=600), StreamSpec(play=recording, loop=True)) as server:
        server.wait(lambda stream: (stream["version"] or 0) > 20)
        page.goto(f"{server.url}/?quality=high")
        chip(page, "Replay")
        assert page.evaluate("phases") == ["connecting", "waiting", "replay"]
        page.wait_for_function("versions.length > 0", **WAIT)
        assert page.evaluate("versions[0]") == 0, "it begins at its begin, not where the server's own playing is"
        shows(page, "s.phase === 'replay' && s.window.newest.version === 39 && s.version !== null")
        assert not page.locator("#t-live").is_visible()
        assert page.locator("#t-loop").get_attribute("aria-pressed") == "true"
        page.evaluate("streamlod.pause(); streamlod.seek(33)")
        shows(page, "s.phase === 'paused' && s.version === 33")
        assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[33].levels]
        page.goto("about:blank")  # it would go on to ask a server that is gone how many watch


def test_a_stream_that_is_made_again_is_shown_again(page: Any, clip: Clip, tmp_path: Path) -> None:
    """Deleted is said; once there is a stream of that name again, its page shows it without a hand."""
    with SlodWriter(tmp_path / "clip.slod") as writer:
        writer.append(clip.key())
    settings, played = Settings(roots=(tmp_path,)), tmp_path / "clip.slod"
    with running(settings, StreamSpec(play=played, loop=False)) as server, server.client() as client:
        page.clock.install()
        page.goto(f"{server.url}/?quality=high&together=1&stream=main")
        shows(page, "s.version === 0")
        client.delete("/v1/streams/main")
        chip(page, "Deleted, this is its last picture")
        client.post("/v1/streams", json={"id": "main", "play": str(played), "start": True})
        page.clock.fast_forward(10_000)  # after which it asks for the streams again
        chip(page, "Replay")
        shows(page, "s.version === 0")


LOSE = """() => {
  const { getContext } = HTMLCanvasElement.prototype;
  HTMLCanvasElement.prototype.getContext = function (...all) {
    const context = getContext.apply(this, all);
    if (this.id === "canvas" && all[0] === "webgl2") window.card = context.getExtension("WEBGL_lose_context");
    return context;
  };
}"""


def test_a_lost_graphics_card_is_said_and_comes_back(page: Any, clip: Clip) -> None:
    """The card names it while it lasts, twice; afterwards the same picture; the server's drawing is the way out."""
    page.add_init_script(f"({LOSE})()")
    with serving(create_app(clip, Behaviour(newest=3))) as url:
        page.goto(f"{url}/?quality=high&ui=0")
        shows(page, "s.version === 3")
        page.evaluate("streamlod.pause()")
        before = picture(page)
        for _ in range(2):
            page.evaluate("card.loseContext()")
            page.locator("#card-title", has_text="The graphics card was taken away").wait_for(**WAIT)
            assert page.locator("#canvas").is_hidden(), "no broken image behind the card"
            page.evaluate("card.restoreContext()")
            page.locator("#card").wait_for(state="hidden", **WAIT)
            comes_to_show(page, before)
        page.evaluate("card.loseContext()")
        page.locator("#card-button", has_text="Let the server draw").click(**WAIT)
        page.wait_for_url("**thin=1**", **WAIT)
        assert "camera=" in page.url
        page.goto("about:blank")
    for remark in ("WebGL", "WebSocket"):
        page.complaints.forgive(remark)


def test_waiting_has_one_bar_and_steady_words(page: Any, clip: Clip) -> None:
    """The bar stands from the first word on and never goes back; training does not talk over lost cameras."""
    page.add_init_script(KEEP_BAR)
    lost = "3 of 5 cameras are lost: cam1, cam2, cam4 (Connection refused)"
    with serving(create_app(clip, Behaviour(state="starting", detail=lost, progress=(0.4, "step 400 of 1000")))) as url:
        page.goto(f"{url}/?quality=high")
        page.locator("#card-title", has_text="Training the first frame").wait_for(**WAIT)
        assert page.locator("#card-text").inner_text() == lost
        seen = page.evaluate("bars")
        assert seen[0] == 0
        assert all(value is not None for value in seen)
        assert sorted(seen) == seen
        assert 0.4 < seen[-1] < 0.5
        page.goto("about:blank")
    page.complaints.forgive("WebSocket connection to")


KEEP_BAR = """
window.bars = [];
document.addEventListener("DOMContentLoaded", () => {
  const card = document.getElementById("card"), bar = document.getElementById("card-progress");
  const note = () => card.hidden || bars.push(bar.hidden ? null : bar.value);
  if (card) new MutationObserver(note).observe(card, { attributes: true, subtree: true, childList: true });
});
"""


def test_a_knocked_camera_is_named_at_the_top_of_the_picture(page: Any, clip: Clip) -> None:
    """With what to do about it."""
    well = {"state": "ok", "fault": "", "silent_ns": 0}
    cameras = {"door": well | {"knocked": True}, "wall": well}
    behaviour = Behaviour(fps=5, state="degraded", detail=complaint({"cameras": cameras}))
    with serving(create_app(clip, behaviour)) as url:
        page.goto(f"{url}/?quality=high")
        chip(page, "Live, but camera door was knocked: put it back or calibrate again")


@pytest.mark.parametrize("width", [360, 640, 1280])
def test_what_is_wrong_with_cameras_is_seen_to_the_end(page: Any, clip: Clip, width: int) -> None:
    """That is where it says what to do. Beside the tools where there is room, else below them."""
    page.set_viewport_size({"width": width, "height": 640})
    well = {"state": "ok", "fault": "", "silent_ns": 0}
    exchanged = "wall and floor are exchanged: swap their names, as each shows what the other's pose sees"
    cameras = {"door": well | {"knocked": True}, "wall": well, "floor": well}
    fault = complaint({"cameras": cameras, "poses": [exchanged]})
    with serving(create_app(clip, Behaviour(fps=5, state="degraded", detail=fault))) as url:
        page.goto(url)
        chip(page, f"Live, but {fault}")
        cut = "(text) => text.scrollHeight > text.clientHeight || text.scrollWidth > text.clientWidth"
        assert page.locator("#status-text").evaluate(cut) is False
        state, tools = page.locator("#identity").bounding_box(), page.locator("#tools").bounding_box()
        assert state["x"] >= 0
        assert state["x"] + state["width"] <= width
        assert state["height"] < 320, "half of the picture at most"
        if tools is not None:  # on a phone they are in a sheet
            below = state["y"] >= tools["y"] + tools["height"]
            assert below or state["x"] + state["width"] <= tools["x"]
