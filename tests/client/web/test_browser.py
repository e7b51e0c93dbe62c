"""The page in a real headless Chromium, against a small server: pictures, state, faults, time."""

from __future__ import annotations

import base64
import contextlib
import functools
import io
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from PIL import Image

from streamlod.codec.container import SlodReader
from streamlod.core.camera import Camera, pinhole
from streamlod.core.render import cpu
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from tests.client.web.conftest import WEB
from tests.client.web.miniserver import Behaviour, Clip, create_app, make_clip, serving
from tests.client.web.scenes import make_scene
from tests.client.web.test_modules import assert_same_splats
from tests.server.ports import held_ports

pytestmark = pytest.mark.browser

Found = TypeVar("Found")

WAIT = {"timeout": 90_000}  # milliseconds: for a machine that is busy with other tests as well
CAPTURE = """async () => {
  const bytes = new Uint8Array(await (await streamlod.captureFrame()).arrayBuffer());
  return btoa(Array.from(bytes, (x) => String.fromCharCode(x)).join(""));
}"""
INSPECT = """async () => {
  const state = await streamlod.inspect();
  return state && { ...state, splats: Array.from(new Uint32Array(state.splats.buffer)) };
}"""
KEEP_TOASTS = """
window.toasts = [];
document.addEventListener("DOMContentLoaded", () => {
  const toast = document.getElementById("toast"), note = () => toast.hidden || toasts.push(toast.textContent);
  if (toast) new MutationObserver(note).observe(toast, { attributes: true, childList: true, subtree: true });
});
"""


def shows(page: Any, condition: str) -> None:
    """Wait until `condition` over the state `s` holds."""
    try:
        page.wait_for_function(f"() => {{ const s = window.streamlod?.state; return s && ({condition}); }}", **WAIT)
    except Exception as error:
        raise AssertionError(f"never {condition}: {page.evaluate('window.streamlod?.state')}") from error


@contextlib.contextmanager
def meets(page: Any, condition: str) -> Iterator[None]:
    """What is done in the context leads to `condition` over the state `s`, which need not hold for long."""
    page.evaluate(f"""() => {{
      window.met = false;
      const look = () => {{
        const s = streamlod.state;
        if ({condition}) met = true;
        if (met) stops.forEach((stop) => stop());
      }};
      const stops = ["status", "picture"].map((name) => streamlod.on(name, look));
    }}""")
    yield
    try:
        page.wait_for_function("met", **WAIT)
    except Exception as error:
        raise AssertionError(f"never {condition}: {page.evaluate('streamlod.state')}") from error


def said(page: Any, text: str) -> None:
    """Wait until the page has said `text`, in a line that goes away by itself. The page needs KEEP_TOASTS."""
    page.wait_for_function("(text) => toasts.some((toast) => toast.includes(text))", arg=text, **WAIT)


def eventually(look: Callable[[], Found]) -> Found:
    """What `look` returns once its assertions hold, for which it is called again and again for a minute."""
    limit = time.monotonic() + 60
    while True:
        try:
            return look()
        except AssertionError:
            if time.monotonic() > limit:
                raise
        time.sleep(0.1)


def picture(page: Any) -> np.ndarray:
    """[H,W,3] float64 in [0, 1]: what is on the canvas."""
    image = Image.open(io.BytesIO(base64.b64decode(page.evaluate(CAPTURE)))).convert("RGB")
    return np.asarray(image, np.float64) / 255


def reference(scene: Scene, camera: Camera) -> np.ndarray:
    """The CPU rasteriser's picture of the same instant and view, by the rules of all viewers."""
    rendered = cpu.render(expand(scene, camera.centre), camera, scene.header.background)
    return np.asarray(rendered.image, np.float64)


def amid_the_scene(page: Any) -> Camera:
    """A view that no camera of the rig comes near, as large as the page's canvas."""
    height, width, _ = picture(page).shape
    pose = np.eye(4)
    pose[:3, 3] = (-0.1, 0.3, 0.4)
    return pinhole("amid", (1.25 * height, 1.25 * height), (width / 2, height / 2), (width, height), pose)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """In decibels; infinitely many between equal pictures."""
    with np.errstate(divide="ignore"):
        return float(-10 * np.log10(np.mean((a - np.clip(b, 0, 1)) ** 2)))


def comes_to_show(page: Any, expected: np.ndarray) -> None:
    """The page shows that picture, if not at once: its order and colours may still be those of the place before."""

    def look() -> None:
        assert psnr(picture(page), expected) >= 35

    eventually(look)


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


def test_reconnects_after_the_server_restarts(page: Any, clip: Clip) -> None:
    """The last picture stays while the server is away, then it goes on."""
    with contextlib.ExitStack() as stack:
        (port,) = stack.enter_context(held_ports(1))
        with serving(create_app(clip, Behaviour(newest=5)), port) as url:
            page.goto(f"{url}/?quality=high")
            shows(page, "s.version === 5")
        shows(page, "s.phase === 'reconnecting'")
        assert page.locator("#card").is_hidden()
        with meets(page, "s.version === 9 && s.phase === 'live'"):
            stack.enter_context(serving(create_app(clip, Behaviour(newest=9, fps=60)), port))
        assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[9].levels]
    page.complaints.forgive("WebSocket connection to")


def test_recording_plays_without_a_server(page: Any, clip: Clip, recording: Path) -> None:
    """A .slod file over Range requests: plays, steps back, ends; the state is exact."""
    with serving(create_app(clip, Behaviour(), recording.parent)) as url:
        page.goto(f"{url}/?src=files/clip.slod&quality=high")
        shows(page, "s.version === 39 && s.phase === 'ended'")
        page.evaluate("streamlod.seek(11)")
        shows(page, "s.version === 11 && s.phase === 'paused'")
        page.keyboard.press(",")
        shows(page, "s.version === 10")
        assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[10].levels]
        page.evaluate("streamlod.loop(true); streamlod.play()")
        shows(page, "s.version < 10 && s.phase === 'replay'")


def test_recording_from_a_server_that_knows_no_ranges(page: Any, clip: Clip, recording: Path, tmp_path: Path) -> None:
    """The page and a file in one folder of the simplest server there is; speed and loop are offered."""
    shutil.copytree(WEB, tmp_path / "site")
    shutil.copy(recording, tmp_path / "site")
    with simple_server(tmp_path / "site") as url:
        page.goto(f"{url}/?src=clip.slod&quality=high")
        shows(page, "s.version === 39 && s.phase === 'ended'")
        page.evaluate("streamlod.seek(17)")
        shows(page, "s.version === 17 && s.phase === 'paused'")
        assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[17].levels]
        assert not page.locator("#t-live").is_visible()
        page.set_viewport_size({"width": 800, "height": 400})
        page.mouse.move(400, 100)  # the controls may have hidden before it was paused
        page.click("#t-speed")
        assert page.locator("#t-speed").inner_text() == "2\u00d7"
        page.click("#t-loop")
        page.evaluate(
            "window.shown = []; streamlod.on('picture', ({ version }) => shown.push(version)); streamlod.play()"
        )
        page.wait_for_function("shown.findIndex((v, i) => i && v < shown[i - 1]) > 0", **WAIT)


@contextlib.contextmanager
def simple_server(folder: Path) -> Iterator[str]:
    """Files by http.server, which answers a request for a range with the whole file."""
    handler = functools.partial(QuietHandler, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()


class QuietHandler(SimpleHTTPRequestHandler):
    """Without lines on the terminal."""

    def log_message(self, *_: object) -> None:
        """Say nothing."""


def splat_in_the_middle(page: Any) -> tuple[int, int]:
    """The pixel near the middle of the picture that differs most from the background, which is its corner."""
    picture = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB")).astype(int)
    middle = picture[80:160, 100:220]
    row, column = np.unravel_index(np.abs(middle - picture[2, 2]).sum(axis=2).argmax(), middle.shape[:2])
    return 100 + int(column), 80 + int(row)


def test_orbit_keys_and_focus(page: Any, clip: Clip) -> None:
    """Dragging orbits around the target; keys walk; double-click turns to a surface; R comes back."""
    with serving(create_app(clip, Behaviour(newest=3))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 3")
        page.evaluate(INSPECT)  # answered after the question how far away the scene is
        poses = [page.evaluate("streamlod.state.camera")]
        page.mouse.move(160, 120)
        page.mouse.down()
        page.mouse.move(220, 130, steps=4)
        page.mouse.up()
        poses.append(page.evaluate("streamlod.state.camera"))
        # before walking, whose length depends on how fast pictures come; where splats are, a ray hits one
        page.mouse.dblclick(*splat_in_the_middle(page))
        page.wait_for_function("(before) => streamlod.state.camera !== before", arg=poses[-1], **WAIT)
        poses.append(page.evaluate("streamlod.state.camera"))
        page.keyboard.down("w")
        page.wait_for_function("(before) => streamlod.state.camera !== before", arg=poses[-1], **WAIT)
        page.keyboard.up("w")
        poses.append(page.evaluate("streamlod.state.camera"))
        page.mouse.wheel(0, 200)
        page.wait_for_function("(before) => streamlod.state.camera !== before", arg=poses[-1], **WAIT)
        assert len(set(poses)) == len(poses)
        page.keyboard.press("r")
        page.wait_for_function("(home) => streamlod.state.camera === home", arg=poses[0], **WAIT)


COUNT_OBJECTS = """
window.objects = {};
for (const name of ["Texture", "Buffer", "Program", "VertexArray", "Shader"]) {
  for (const [verb, step] of [["create", 1], ["delete", -1]]) {
    const old = WebGL2RenderingContext.prototype[verb + name];
    WebGL2RenderingContext.prototype[verb + name] = function (...all) {
      objects[name] = (objects[name] ?? 0) + step;
      return old.apply(this, all);
    };
  }
}
"""


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


def test_real_server_restarted_in_mid_stream(page: Any, clip: Clip, recording: Path) -> None:
    """A server stops while frames arrive, and another takes its place: the page waits, then shows that one's stream."""
    from streamlod.server.pipeline.spec import StreamSpec
    from streamlod.server.settings import Settings
    from tests.server.conftest import running

    with held_ports(1) as (port,):
        with running(Settings(), StreamSpec(play=recording, loop=True), port=port) as server:
            page.goto(f"{server.url}/?quality=high&together=1")
            shows(page, "s.version > 3")
        shows(page, "s.phase === 'reconnecting'")
        assert page.locator("#card").is_hidden()
        with running(Settings(), StreamSpec(play=recording, loop=False), port=port):
            shows(page, "s.version === 39 && s.phase !== 'reconnecting'")
            assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[39].levels]
    page.complaints.forgive("WebSocket connection to")


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


def test_what_is_asked_for_without_a_connection_counts_once_there_is_one(page: Any, clip: Clip) -> None:
    """A place sought, and a pause, while the server is away."""
    behaviour = Behaviour(newest=30)
    with contextlib.ExitStack() as stack, held_ports(1) as (port,):
        with serving(create_app(clip, behaviour), port) as url:
            page.goto(f"{url}/?quality=high")
            shows(page, "s.version === 30 && s.phase === 'live'")
        shows(page, "s.phase === 'reconnecting'")
        page.evaluate("streamlod.seek(5); streamlod.pause()")
        stack.enter_context(serving(create_app(clip, behaviour), port))
        shows(page, "s.version === 5 && s.phase === 'paused'")
        page.evaluate("streamlod.play()")
        shows(page, "s.version > 20")
        page.goto("about:blank")
    page.complaints.forgive("WebSocket connection to")


def test_a_file_plays_what_is_whole(page: Any, clip: Clip, recording: Path, tmp_path: Path) -> None:
    """Cut in the middle it plays up to there; with a damaged packet it ends before that and says so."""
    whole = recording.read_bytes()
    with SlodReader(recording) as reader:
        places = [entry.offset for entry in reader.entries]
    (tmp_path / "cut.slod").write_bytes(whole[: places[6] + 40])  # of version 6 the begin only
    damaged = bytearray(whole)
    damaged[places[6] + 60] ^= 0xFF
    (tmp_path / "damaged.slod").write_bytes(bytes(damaged))
    with serving(create_app(clip, Behaviour(), tmp_path)) as url:
        page.goto(f"{url}/?src=files/cut.slod&quality=high")
        shows(page, "s.phase === 'ended' && s.version === 5 && s.window.newest.version === 5")
        page.goto(f"{url}/?src=files/damaged.slod&quality=high")
        shows(page, "s.phase === 'ended' && s.version === 5 && s.window.newest.version === 5")
        page.locator("#status-text", has_text="a part of the file is damaged").wait_for(**WAIT)
        assert page.title().startswith("damaged.slod")
        page.evaluate("streamlod.seek(3)")  # at once after the end: still there
        shows(page, "s.version >= 3")


def test_a_flight_ends_when_the_viewer_is_led_elsewhere(page: Any, clip: Clip) -> None:
    """As by an embedding page, which would else be led back; the opening shot is such a flight."""
    place = "streamlod.state.camera.split(',').slice(0, 3).join()"
    with serving(create_app(clip, Behaviour(newest=3))) as url:
        page.goto(f"{url}/?sway=0&quality=high")
        shows(page, "s.version === 3")
        before = page.evaluate(place)
        page.keyboard.press("t")
        page.wait_for_function(f"(before) => {place} !== before", arg=before, **WAIT)
        page.evaluate("streamlod.setCamera(0)")
        led = page.evaluate(place)
        page.wait_for_timeout(500)
        assert page.evaluate(place) == led != before


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
