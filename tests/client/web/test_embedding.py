"""The page inside pages of other sites: who may frame it, what they can call, and what is taken along from it."""

from __future__ import annotations

import html
import itertools
import re
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from starlette.middleware.cors import CORSMiddleware

from streamlod.codec.container import SlodReader
from streamlod.codec.decoder import SceneDecoder
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.simple_server import QuietHandler
from tests.client.web.watching import KEEP_TOASTS, WAIT, eventually, said, shows
from tests.server.conftest import running

pytestmark = pytest.mark.browser

DISTANCE = 9  # its place among the numbers of a view as text

HOST = """<!doctype html><link rel=icon href="data:,"><body style="margin: 0; height: 3000px">
<script src="{url}/player.js"></script>
<streamlod-player stream="main" quality="high" {more} style="width: 320px; height: 240px"></streamlod-player>
<script>
  const player = document.querySelector("streamlod-player");
  const told = (promise) => promise.then((result) => ["result", result], (error) => ["error", error.message]);
</script>"""


@dataclass(frozen=True)
class Site:
    """The viewer's server, and a folder that another origin serves."""

    url: str
    origin: str
    folder: Path

    def write(self, name: str, more: str = "") -> str:
        """A page with a player; its address."""
        (self.folder / name).write_text(HOST.format(url=self.url, more=more))
        return f"{self.origin}/{name}"


@pytest.fixture(scope="module")
def site(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """The real server with a recording, which one other origin may frame."""
    folder = tmp_path_factory.mktemp("host")
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(QuietHandler, directory=str(folder))) as host:
        thread = threading.Thread(target=host.serve_forever)
        thread.start()
        origin = f"http://localhost:{host.server_port}"
        try:
            with running(Settings(frame_ancestors=(origin,)), StreamSpec(play=recording, loop=False)) as server:
                yield Site(server.url, origin, folder)
        finally:
            host.shutdown()
            thread.join()


def test_every_call_is_answered(page: Any, site: Site) -> None:
    """The element on another origin: poster, events, results, and an error for what is wrong."""
    page.goto(site.write("host.html", 'poster="data:,"'))
    assert page.locator("iframe").count() == 0, "nothing is loaded before somebody asks for it"
    page.evaluate("player.addEventListener('picture', (e) => { window.shown = e.detail; })")
    page.locator("button[aria-label=Play]").click()
    page.wait_for_function("window.shown?.version === 39", **WAIT)
    before = list(itertools.islice(iter(lambda: page.evaluate("player.state()")["phase"], "ended"), 5000))
    assert set(before) <= {"connecting", "waiting", "replay"}
    answers = page.evaluate("""async () => ({
      state: await told(player.state()), pause: await told(player.pause()), seek: await told(player.seek(12)),
      picture: await told(player.captureFrame().then((blob) => [blob.type, blob.size > 500])),
      camera: await told(player.setCamera(1)), noCamera: await told(player.setCamera("x")),
      noFrame: await told(player.seek("twelve")), noMethod: await told(player.call("fly", 1)),
    })""")
    assert answers["state"][1]["phase"] == "ended"
    assert answers["pause"] == answers["seek"] == answers["camera"] == ["result", None]
    assert answers["picture"] == ["result", ["image/png", True]]
    assert answers["noCamera"] == ["error", "no such camera"]
    assert answers["noFrame"] == ["error", 'seek takes a frame number or "live"']
    assert answers["noMethod"][0] == "error"
    assert "there is no method fly" in answers["noMethod"][1]
    page.wait_for_function("window.shown.version === 12", **WAIT)
    assert page.evaluate("player.inspect().then((state) => state.version)") == 12
    old = page.evaluate("""new Promise((resolve) => {
      addEventListener("message", ({ data }) => data.id === "old" && resolve(data));
      const inside = player.shadowRoot.querySelector("iframe").contentWindow;
      inside.postMessage({ streamlod: "state", version: 9, id: "old" }, "*");
    })""")
    assert old["error"] == "this page speaks version 1 of the messages"
    page.evaluate("player.destroy()")
    assert page.evaluate("told(player.state())") == ["error", "the player was destroyed"]


def settled(page: Any) -> str:
    """Where the player's camera stands, once the scene has put it there and nothing has moved it for half a second."""
    shown, quiet = "", 0
    while quiet < 5:
        page.wait_for_timeout(100)
        now = page.evaluate("player.state()")["camera"]
        shown, quiet = now, quiet + 1 if now == shown and not now.startswith("0,0,-3,") else 0
    return shown


def test_the_wheel_is_the_pages_until_a_click(page: Any, site: Site) -> None:
    """The wheel scrolls the other page; after a click inside it zooms; keys elsewhere do nothing."""
    page.goto(site.write("wheel.html"))
    page.wait_for_function("player.shadowRoot?.querySelector('iframe')", **WAIT)
    page.wait_for_function("told(player.state()).then(([, state]) => state?.version === 39)", **WAIT)
    before = settled(page)
    page.mouse.move(160, 120)
    page.mouse.wheel(0, 60)
    page.wait_for_function("scrollY === 60", **WAIT)  # it may scroll smoothly
    page.wait_for_timeout(1000)  # a wheel that follows at once belongs to the same scroll, whatever the page says to it
    page.evaluate("scrollTo(0, 0)")
    page.wait_for_function("scrollY === 0", **WAIT)
    assert page.evaluate("player.state()")["camera"] == before
    page.mouse.click(160, 120)
    page.mouse.wheel(0, 60)
    page.wait_for_function("(before) => player.state().then((state) => state.camera !== before)", arg=before, **WAIT)
    assert page.evaluate("scrollY") == 0


def test_other_sites_may_not_frame_it(page: Any, site: Site) -> None:
    """An origin that is not listed gets no page into its frame."""
    page.goto(site.write("other.html").replace("localhost", "127.0.0.1"))
    page.wait_for_function("player.shadowRoot?.querySelector('iframe')", **WAIT)

    def refuses() -> None:
        page.wait_for_timeout(100)  # in which Playwright hears of frames
        inside = [frame.url for frame in page.frames if frame is not page.main_frame]
        assert ["chrome-error" in url for url in inside] == [True]

    eventually(refuses)
    page.complaints.forgive("frame-ancestors")


def without_distance(camera: str) -> list[str]:
    """A view's numbers but the distance to what it turns around, which the page's worker tells a moment later."""
    numbers = camera.split(",")
    return numbers[:DISTANCE] + numbers[DISTANCE + 1 :]


def test_links_keep_the_moment(page: Any, clip: Clip, recording: Path) -> None:
    """A copied link opens paused at the frame and view that were shown: live, and from a file."""
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.add_init_script(KEEP_TOASTS)
    page.set_viewport_size({"width": 900, "height": 500})
    behaviour = Behaviour(newest=14)
    with serving(create_app(clip, behaviour, recording.parent)) as url:
        for address, version in ((f"{url}/?quality=high", 14), (f"{url}/?quality=high&src=files/clip.slod", 39)):
            page.goto(address)
            shows(page, f"s.version === {version}")
            page.evaluate("streamlod.setCamera(1)")
            camera = page.evaluate("streamlod.state.camera")
            page.click("#b-share")
            page.locator("#share-menu button", has_text="Copy link to this moment").click()
            said(page, "moment copied")
            link = page.evaluate("navigator.clipboard.readText()")
            behaviour.newest = 20
            page.goto(link)
            shows(page, f"s.version === {version} && (s.phase === 'paused' || s.phase === 'ended')")
            opened = page.evaluate("streamlod.state.camera")
            assert without_distance(opened) == without_distance(camera)
        page.click("#b-share")
        page.locator("#share-menu button", has_text="Copy embed code").click()
        said(page, "other pages")
        code = page.evaluate("navigator.clipboard.readText()")
        address = html.unescape(re.search('src="(.+?)"', code)[1])  # type: ignore[index]
        assert address.startswith(url)
        assert "embed=1" in address
        assert "src=files" in address
        with page.expect_download() as download:
            page.click("#b-share")
            page.locator("#share-menu button", has_text="Download recording").click()
        assert Path(download.value.path()).read_bytes() == recording.read_bytes()
        page.evaluate("streamlod.seek(12)")
        shows(page, "s.version === 12")
        page.click("#b-share")
        page.locator("#share-menu button", has_text="Mark this moment").click()
        page.evaluate("streamlod.seek(5)")
        shows(page, "s.version === 5")
        with page.expect_download() as download:
            page.click("#b-share")
            page.locator("#share-menu button", has_text="Clip since the mark").click()
        assert download.value.suggested_filename == "clip-5-12.slod"
        with SlodReader(download.value.path()) as reader:
            decoder = SceneDecoder()
            for number in reader.plan(12):
                decoder.push(reader.read(number))
            assert max(entry.to_version for entry in reader.entries) == 12
        assert decoder.scene is not None
        assert [level.digest() for level in decoder.scene.levels] == [
            level.digest() for level in clip.states[12].levels
        ]


def test_missing_cors_is_named(page: Any, site: Site, clip: Clip, recording: Path) -> None:
    """A file of a server that does not list the page's origin: the page says whose headers are missing, and which."""
    half = CORSMiddleware(create_app(clip, Behaviour(), recording.parent), allow_origins=["*"], allow_headers=["*"])
    fault = page.locator("#card-text")
    with serving(create_app(clip, Behaviour())) as own, serving(half) as other:
        page.goto(f"{own}/?src={site.url}/v1/streams/main/bitstream")
        fault.get_by_text(f"{site.url} does not answer, or does not let pages of other sites").wait_for(**WAIT)
        page.goto(f"{own}/?src={other}/files/clip.slod")
        fault.get_by_text("hides the header Content-Range from pages of other sites (CORS)").wait_for(**WAIT)
        with running(Settings(origins=(own,)), StreamSpec(play=recording, loop=False)) as server:
            server.wait(lambda stream: stream["state"] == "ended")
            page.goto(f"{own}/?src={server.url}/v1/streams/main/bitstream")
            shows(page, "s.version === 39")
    page.complaints.forgive("CORS policy")
    page.complaints.forgive("net::ERR_FAILED")
