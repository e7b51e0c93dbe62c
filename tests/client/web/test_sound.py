"""Sound in step with the pictures of a recording, in Chromium, from a real server."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from streamlod.codec.sound.beside import sound_beside
from streamlod.codec.sound.opus import write_sound
from streamlod.server.auth.gate import hash_token
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.clicks import clicks
from tests.client.web.miniserver import Behaviour, Clip, create_app, make_clip, serving
from tests.client.web.scenes import make_scene
from tests.client.web.watching import WAIT, shows
from tests.server.conftest import Running, running

pytestmark = pytest.mark.browser
FRAMES, FRAME_MS = 200, 100
BEGIN_MS = 250  # the sound begins after the pictures

# Collects, whenever a picture comes, how far the sound is from what the screen then shows: a played picture is reached
# only after `overMs`.
WATCH = """() => {
  window.speed = 1;
  window.offsets = [];
  streamlod.on("picture", ({ timeMs, overMs }) => {
    const { sound } = streamlod.state;
    if (sound?.playing) window.offsets.push(sound.timeMs - (timeMs - speed * (overMs ?? 0)));
  });
}"""
# The newest 15 are in step, in time of the wall.
IN_STEP = """() => {
  const newest = window.offsets.slice(-15).map((off) => Math.abs(off) / speed).sort((a, b) => a - b);
  return newest.length === 15 && newest[7] <= 40;
}"""


@pytest.fixture(scope="module")
def sounding(kernel: bytes, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty seconds at ten pictures a second, with sound."""
    clip = make_clip(make_scene(60), FRAMES, frame_ns=FRAME_MS * 1_000_000)
    path = tmp_path_factory.mktemp("sounding") / "clip.slod"
    clip.write(path)
    write_sound(sound_beside(path), [clicks(19.0)], 1, BEGIN_MS * 1_000_000)
    return path


@contextmanager
def served(page: Any, settings: Settings, path: Path, loop: bool = True) -> Iterator[Running]:
    """A server that plays a file; the page leaves it before it ends, and so has nothing to complain of."""
    with running(settings, StreamSpec(play=path, loop=loop)) as server:
        yield server
        page.goto("about:blank")


def in_step(page: Any, begin: int = 0) -> None:
    """Wait until sound and picture have been within 40 ms for a while, again from version `begin` where a clip ends."""
    page.evaluate("window.offsets = []")
    limit = time.monotonic() + WAIT["timeout"] / 1000
    while not page.evaluate(IN_STEP):
        assert time.monotonic() < limit, page.evaluate("[streamlod.state, window.offsets]")
        if page.evaluate("streamlod.state.phase") in ("ended", "paused"):  # who seeks after the end stands there
            page.evaluate("(begin) => { streamlod.seek(begin); streamlod.play(); }", begin)
        page.wait_for_timeout(100)


@pytest.mark.long
def test_sound_follows_the_picture(page: Any, sounding: Path) -> None:
    asked = []
    page.on("request", lambda request: asked.append(request.url.rpartition("/")[2]))
    page.set_viewport_size({"width": 640, "height": 360})
    with served(page, Settings(), sounding, loop=False) as server:
        page.goto(f"{server.url}/?quality=low&sway=0")
        shows(page, "s.sound !== null && s.version > 2")
        assert not page.evaluate("streamlod.state.sound.on")
        assert "sound" not in asked  # nobody wants it yet
        page.locator("#t-sound").click()
        page.evaluate(WATCH)
        page.evaluate("streamlod.seek(3)")  # a busy machine may have played most of the clip by now
        in_step(page, 3)
        assert page.evaluate("streamlod.state.sound.timeMs") > BEGIN_MS
        page.evaluate("streamlod.pause()")
        shows(page, "s.phase === 'paused' && !s.sound.playing")
        page.evaluate("streamlod.seek(100)")
        shows(page, "s.version === 100")
        page.evaluate("streamlod.play()")
        in_step(page, 100)
        assert 100 * FRAME_MS < page.evaluate("streamlod.state.sound.timeMs") < FRAMES * FRAME_MS
        page.evaluate("streamlod.seek(20)")  # back, while it plays
        shows(page, "s.version < 90")
        in_step(page, 20)
        page.locator("#t-volume").fill("0.25")
        assert page.evaluate("streamlod.state.sound.volume") == 0.25
        page.locator("#t-sound").click()
        shows(page, "!s.sound.on && !s.sound.playing")
        page.locator("#t-sound").click()
        page.evaluate("streamlod.seek(10)")
        shows(page, "s.version < 90")
        page.locator("#t-speed").click()
        page.evaluate("window.speed = 2")
        page.evaluate("streamlod.seek(10)")
        in_step(page, 10)
        page.evaluate("streamlod.seek(195)")
        shows(page, "s.phase === 'ended' && !s.sound.playing")


@pytest.mark.long
def test_sound_follows_pictures_that_were_filmed_unevenly(page: Any, tmp_path: Path) -> None:
    """As where training leaves out some: 200 and 600 ms apart in turn, and all are shown as late as each other."""
    path = tmp_path / "clip.slod"
    replace(make_clip(make_scene(60), 60, frame_ns=400_000_000), late_ns=200_000_000).write(path)
    write_sound(sound_beside(path), [clicks(24.0)], 1, 0)
    page.set_viewport_size({"width": 640, "height": 360})
    with served(page, Settings(), path) as server:
        page.goto(f"{server.url}/?quality=low&sway=0")
        shows(page, "s.sound !== null && s.version > 2")
        page.locator("#t-sound").click()
        page.evaluate(WATCH)
        page.evaluate("streamlod.seek(3)")
        in_step(page, 3)


# How far the sound is from what was filmed when a picture comes, ms; nothing while it is silent.
AT_PICTURES = """() => {
  window.off = {};
  streamlod.on("picture", ({ timeMs, version }) => {
    const { sound } = streamlod.state;
    window.off[version] ??= sound?.playing ? sound.timeMs - timeMs : null;
  });
}"""
APART_MS = 3000


def sparse(folder: Path) -> Path:
    """What a slow machine records: pictures seconds apart, and all of the sound."""
    path = folder / "clip.slod"
    make_clip(make_scene(60), 7, frame_ns=APART_MS * 1_000_000).write(path)
    write_sound(sound_beside(path), [clicks(21.0)], 1, 0)
    return path


def arrives(page: Any, version: int) -> None:
    """Wait for a picture, at which its sound is heard. The page needs AT_PICTURES.

    A busy machine may show one late, or before its sound plays: then it is sought again.
    """
    off = None
    for _ in range(3):
        page.wait_for_function("(version) => version in off", arg=version, **WAIT)
        off = page.evaluate("(version) => off[version]", version)
        if off is not None and abs(off) < 150:
            return
        page.evaluate("(version) => { delete off[version]; streamlod.seek(version - 1); }", version)
    raise AssertionError(f"{off} ms off, three times")


@pytest.mark.long
def test_sound_goes_on_between_pictures_that_are_seconds_apart(page: Any, kernel: bytes, tmp_path: Path) -> None:
    """From the first picture on, also paused between two of them, begun anew at the one that is shown, and faster."""
    with served(page, Settings(), sparse(tmp_path), loop=False) as server:
        page.goto(f"{server.url}/?quality=low&sway=0")
        shows(page, "s.sound !== null && s.version !== null")
        page.locator("#t-sound").click()
        page.evaluate(AT_PICTURES)
        page.evaluate("streamlod.seek(0)")
        arrives(page, 1)
        shows(page, f"s.sound.timeMs > {APART_MS + 1500}")
        page.evaluate("streamlod.pause()")
        shows(page, "s.phase === 'paused' && !s.sound.playing")
        page.wait_for_timeout(1000)
        page.evaluate("streamlod.play()")
        shows(page, f"s.sound.playing && s.version === 1 && s.sound.timeMs > {APART_MS + 1500}")  # where it stopped
        arrives(page, 2)
        shows(page, f"s.sound.timeMs > {2 * APART_MS + 1500}")
        page.evaluate("streamlod.seek(2)")
        shows(page, f"s.sound.playing && s.sound.timeMs < {2 * APART_MS + 1500}")
        arrives(page, 3)
        page.locator("#t-speed").click()
        arrives(page, 4)


@pytest.mark.long
def test_sound_begins_anew_with_a_picture_that_is_shown_already(page: Any, kernel: bytes, tmp_path: Path) -> None:
    """In the past of a stream, over the websocket: pictures there are loaded again, and none is new."""
    with served(page, Settings(), sparse(tmp_path)) as server:
        page.goto(f"{server.url}/?quality=low&sway=0&together=1")
        shows(page, "s.sound !== null && s.window?.newest.version >= 2")
        page.locator("#t-sound").evaluate("button => button.click()")
        page.evaluate(AT_PICTURES)
        page.evaluate("streamlod.seek(0)")
        shows(page, "s.version === 0 && s.sound.playing && s.sound.timeMs > 1500 && s.sound.timeMs < 2800")
        page.evaluate("streamlod.seek(0)")
        shows(page, "s.version === 0 && s.sound.playing && s.sound.timeMs < 1500")
        arrives(page, 1)


# Notes what goes to the loudspeakers where the page mixes it itself.
TAP = """
  const connect = AudioNode.prototype.connect;
  AudioNode.prototype.connect = function (to, ...more) {
    if (to instanceof AudioDestinationNode) window.out ??= this;
    return connect.call(this, to, ...more);
  };
"""
# What comes out of the audio element, and when pictures are shown, both by the clock of the page.
LISTEN = """() => {
  window.heard = [];
  window.shown = [];
  streamlod.on("picture", ({ timeMs, overMs }) => window.shown.push([timeMs - (overMs ?? 0), performance.now()]));
  const context = window.out?.context ?? new AudioContext({ sampleRate: 48000 }), listener = context.createAnalyser();
  listener.fftSize = 32768;
  if (window.out) window.out.connect(listener);
  else context.createMediaElementSource(window.playing).connect(listener).connect(context.destination);
  const late = window.out ? 1000 * (context.baseLatency + context.outputLatency) : 0;
  const samples = new Float32Array(listener.fftSize);
  setInterval(() => {
    listener.getFloatTimeDomainData(samples);
    const at = performance.now(), first = samples.findIndex((sample) => Math.abs(sample) > 0.2);
    const clicked = at - (1000 * (samples.length - first)) / context.sampleRate + late;
    if (first > 0 && clicked - (window.heard.at(-1) ?? -Infinity) > 500) window.heard.push(clicked);
  }, 50);
}"""
# How far the newest five clicks were heard from the moment at which their second was on the screen.
CLICKS = """(begin) => window.heard.slice(-5).map((at) => {
  const [timeMs, when] = window.shown.findLast(([, when]) => when <= at) ?? [NaN, NaN];
  const filmed = timeMs + at - when - begin;
  return filmed - 1000 * Math.round(filmed / 1000);
})"""


@pytest.mark.long
@pytest.mark.parametrize("camera", [None, "cam00"])
def test_clicks_are_heard_when_their_pictures_are_seen(
    page: Any, sounding: Path, tmp_path: Path, camera: str | None
) -> None:
    """From the samples that the browser puts out, not from what its element says of itself."""
    played = tmp_path / "clip.slod"
    shutil.copy(sounding, played)
    write_sound(sound_beside(played), [clicks(19.0)], 1, BEGIN_MS * 1_000_000, camera)
    page.add_init_script(TAP)
    page.set_viewport_size({"width": 640, "height": 360})
    page.add_init_script(
        "window.Audio = class { constructor() { return (window.playing = document.createElement('audio')); } };"
    )
    with served(page, Settings(), played) as server:
        page.goto(f"{server.url}/?quality=low&sway=0")
        shows(page, "s.sound !== null && s.version > 2")
        page.locator("#t-sound").click()
        shows(page, f"s.sound.playing && s.sound.placed === {json.dumps(camera is not None)}")
        page.evaluate(LISTEN)
        in_time = f"""(begin) => {{
            const offs = ({CLICKS})(begin).map(Math.abs).sort((a, b) => a - b);
            return offs.length === 5 && offs[2] <= 40;
        }}"""
        try:
            page.wait_for_function(in_time, arg=BEGIN_MS, **WAIT)
        except Exception as error:
            raise AssertionError(f"{page.evaluate(CLICKS, BEGIN_MS)}") from error


# How loud each ear is, over the newest 0.3 s: [left, right].
EARS = """() => {
  const { context } = window.out, split = context.createChannelSplitter(2);
  window.out.connect(split);
  const ears = [0, 1].map((side) => {
    const ear = context.createAnalyser();
    ear.fftSize = 16384;
    split.connect(ear, side);
    return ear;
  });
  const samples = new Float32Array(16384);
  window.ears = () => ears.map((ear) => {
    ear.getFloatTimeDomainData(samples);
    return Math.hypot(...samples) / 128;
  });
}"""


def test_sound_comes_from_where_its_microphone_stands(page: Any, sounding: Path, tmp_path: Path) -> None:
    """Louder in the right ear of who has the microphone at the right, in the left one of who has turned about."""
    played = tmp_path / "clip.slod"
    shutil.copy(sounding, played)
    hum = (8000 * np.sin(2 * np.pi * 700 * np.arange(19 * 48_000) / 48_000)).astype(np.int16)[:, None]
    write_sound(sound_beside(played), [hum], 1, 0, "cam04")
    page.set_viewport_size({"width": 640, "height": 360})
    page.add_init_script(TAP)
    with served(page, Settings(), played) as server:
        assert server.stream()["sound"]["camera"] == "cam04"
        page.goto(f"{server.url}/?quality=low&sway=0")
        shows(page, "s.sound !== null && s.version > 2")
        page.locator("#t-sound").click()
        shows(page, "s.sound.placed && s.sound.playing")
        page.evaluate(EARS)
        for ahead, loud in ((1, "right > 1.5 * left"), (-1, "left > 1.5 * right")):
            # near the scene's middle cam04, which stands at x = 2.06, is at the right of who looks along +z
            page.evaluate(f"streamlod.setCamera('0,-0.9,-2.4, 0,0,{ahead}, 0,1,0, 3,1,0,0,1')")
            page.wait_for_function(f"() => {{ const [left, right] = ears(); return left > 0 && {loud}; }}", **WAIT)
        page.locator("#t-volume").fill("0")
        page.wait_for_function("() => Math.max(...ears()) === 0", **WAIT)


def test_sound_that_is_long_in_coming_stays_on(page: Any, sounding: Path) -> None:
    """Pictures may stop before the first sound is there, and go on later."""
    page.set_viewport_size({"width": 640, "height": 360})
    page.add_init_script(
        "window.Audio = class { constructor() { return (window.playing = document.createElement('audio')); } };"
    )
    held: list[Any] = []
    page.route("**/v1/streams/main/sound", lambda route: held.append(route))  # noqa: PLW0108 - no builtin
    with served(page, Settings(), sounding) as server:
        page.goto(f"{server.url}/?quality=low&sway=0")
        shows(page, "s.sound !== null && s.version > 2")
        page.locator("#t-sound").click()
        page.wait_for_function("!playing.paused", **WAIT)
        page.evaluate("streamlod.pause()")
        page.wait_for_function("playing.paused", **WAIT)
        assert held
        held.pop().continue_()
        page.unroute("**/v1/streams/main/sound")
        page.evaluate("streamlod.play()")
        shows(page, "!s.sound.on || s.sound.playing")
        assert page.evaluate("streamlod.state.sound.on")


def test_sound_of_a_stream_that_needs_a_token(page: Any, sounding: Path, tmp_path: Path) -> None:
    tokens = tmp_path / "tokens.json"
    tokens.write_text(json.dumps([{"name": "a", "sha256": hash_token("a"), "rights": ["read"], "streams": "main"}]))
    page.set_viewport_size({"width": 640, "height": 360})
    with served(page, Settings(tokens=tokens), sounding) as server:
        page.goto(f"{server.url}/?quality=low&sway=0&token=a")
        shows(page, "s.sound !== null && s.version > 2")
        page.locator("#t-sound").click()
        shows(page, "s.sound.playing && s.sound.timeMs > 500")


def test_one_clock_for_all_who_watch_together(page: Any, sounding: Path) -> None:
    """The server plays, and begins again at the end; pictures come over the websocket."""
    page.set_viewport_size({"width": 640, "height": 360})
    with served(page, Settings(), sounding) as server:
        page.goto(f"{server.url}/?quality=low&sway=0&together=1")
        shows(page, "s.sound !== null && s.version > 2")
        page.locator("#t-sound").click()
        page.evaluate(WATCH)
        in_step(page)


def test_a_file_of_any_site_is_played_with_its_sound(page: Any, clip: Clip, sounding: Path) -> None:
    """`sound=` beside `src=`: its begin is read from the file, once somebody wants it."""
    page.set_viewport_size({"width": 640, "height": 360})
    with serving(create_app(clip, Behaviour(), sounding.parent)) as url:
        page.goto(f"{url}/?src=files/clip.slod&sound=files/clip.slod.opus&quality=low&sway=0")
        shows(page, "s.sound !== null && s.version > 2")
        assert page.evaluate("performance.getEntriesByType('resource').every(({ name }) => !name.endsWith('.opus'))")
        page.locator("#t-sound").click()
        page.evaluate(WATCH)
        in_step(page)
        begin = page.evaluate("streamlod.state.sound.beginMs")
        assert begin == BEGIN_MS
        page.goto("about:blank")


def test_a_stream_without_sound_loads_nothing_for_it(page: Any, recording: Path) -> None:
    asked = []
    page.on("request", lambda request: asked.append(request.url.rpartition("/")[2]))
    with served(page, Settings(), recording) as server:
        page.goto(f"{server.url}/")
        shows(page, "s.version > 2 && s.viewers !== null")
        assert page.evaluate("streamlod.state.sound") is None
        assert not {"sound", "sound.js"} & set(asked)
