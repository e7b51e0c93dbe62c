"""`python -m tests.client.web.screenshots OUT`: the page's states and sizes as pictures, for people to look at."""

from __future__ import annotations

import argparse
import io
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

from streamlod.codec.container import SlodReader
from streamlod.codec.decoder import SceneDecoder
from streamlod.core.scene.anchors import Scene
from tests.client.web.conftest import TEST_FLAGS, chromium_path
from tests.client.web.miniserver import Behaviour, Clip, create_app, make_clip, serving
from tests.client.web.scenes import make_scene

PHONE, TABLET, DESKTOP = (390, 844), (1024, 768), (1280, 720)


@dataclass(frozen=True)
class Shot:
    """One picture: what the server does, the page's size and theme, and what a person does before it is taken."""

    name: str
    behaviour: Behaviour
    size: tuple[int, int] = DESKTOP
    theme: str = "dark"
    address: str = "/"
    act: str = ""
    live: bool = True
    stop: bool = False


def shots() -> list[Shot]:
    """All of them."""
    full = Behaviour(newest=30)
    lost = Behaviour(state="starting", detail="3 of 5 cameras are lost: cam1, cam2, cam4 (Connection refused)")
    knocked = replace(full, fps=5, state="degraded", detail="camera door was knocked: put it back or calibrate again; "
                      "until then the stream goes on without it")  # fmt: skip
    training = Behaviour(state="starting", progress=(0.4, "step 400 of 1000"))
    films = {"cam01": jpeg()}
    many = Behaviour(newest=30, streams=("main", "stage left", "rehearsal"))
    return [
        Shot("live-desktop-dark", many),
        Shot("live-desktop-light", many, theme="light"),
        Shot("live-tablet", full, TABLET),
        Shot("readme", full, (960, 540), address="/?quality=high"),
        Shot("live-phone-dark", full, PHONE),
        Shot("live-phone-light", many, PHONE, "light"),
        Shot("phone-landscape", full, (844, 390)),
        Shot("phone-sheet", full, PHONE, act="button:#b-more"),
        Shot("phone-source", Behaviour(fps=2, camera_pictures=films), PHONE, act="key:2"),
        Shot("statistics", full, act="button:#b-stats"),
        Shot("statistics-phone", full, PHONE, act="button:#b-stats"),
        Shot("cameras", full, act="button:#b-cameras"),
        Shot("cameras-phone", full, PHONE, act="button:#b-cameras"),
        Shot("rig", full, act="rig"),
        Shot("quality", full, act="button:#b-quality"),
        Shot("help", full, act="button:#b-help"),
        Shot("help-phone-light", full, PHONE, "light", act="button:#b-help"),
        Shot("streams", many, act="button:#stream-name"),
        Shot("share", full, act="button:#b-share"),
        Shot("peek", full, act="hover:#t-scrub", address="/?src=files/clip.slod&marks=4,20"),
        Shot("source", Behaviour(fps=2, camera_pictures=films), act="key:2"),
        Shot("outside", full, act="wheel:5000"),
        Shot("behind", Behaviour(fps=2), act="js:streamlod.seek(2); streamlod.play()"),
        Shot("preview", Behaviour(state="starting", preview=True, progress=(0.4, "step 400 of 1000"))),
        Shot("ended", Behaviour(state="ended", newest=30)),
        Shot("deleted", Behaviour(newest=30), act="leave"),
        Shot("paused", full, act="js:streamlod.seek(12); streamlod.pause()"),
        Shot("recording", full, address="/?src=files/clip.slod"),
        Shot("stalled", full, act="wait:3500"),
        Shot("training", training, live=False),
        Shot("training-phone-light", training, PHONE, "light", live=False),
        Shot("waiting", Behaviour(state="idle"), live=False),
        Shot("knocked", knocked),
        Shot("knocked-phone", knocked, (360, 640)),
        Shot("cameras-lost", lost, live=False),
        Shot("cameras-lost-phone", lost, PHONE, live=False),
        Shot("graphics-lost", full, act="lose"),
        Shot("graphics-lost-phone", full, PHONE, act="lose"),
        Shot("paths", full, act="paths"),
        Shot("paths-phone", full, PHONE, act="paths"),
        Shot("dropping", full, act="js:document.body.classList.add('dropping')"),
        Shot("past-phone", Behaviour(fps=2), PHONE, act="js:streamlod.seek(2); streamlod.play()"),
        Shot("paused-phone", full, PHONE, act="js:streamlod.seek(12); streamlod.pause()"),
        Shot("ended-phone", Behaviour(state="ended", newest=30), PHONE),
        Shot("recording-phone", full, PHONE, address="/?src=files/clip.slod"),
        Shot("too-slow", full, act="offer"),
        Shot("version", Behaviour(version=2), live=False),
        Shot("denied", Behaviour(close=(4401, "The token has expired")), live=False, theme="light"),
        Shot("missing", Behaviour(close=(4404, "there is no such stream")), live=False),
        Shot("failed", Behaviour(close=(1009, "a message was too big")), live=False),
        Shot("reconnecting", full, stop=True),
        Shot("reconnecting-phone", full, PHONE, stop=True),
        Shot("unreachable", Behaviour(close=(1013, "The server is full")), live=False),
        Shot("no-webgl", full, address="/?", act="no-webgl", live=False),
        Shot("embedded", full, (480, 270), address="/?embed=1"),
        Shot("bare", full, (480, 270), address="/?embed=1&ui=0"),
    ]


def jpeg() -> bytes:
    """What a camera might film."""
    file = io.BytesIO()
    Image.linear_gradient("L").resize((320, 240)).convert("RGB").save(file, "JPEG")
    return file.getvalue()


def lose(page: Any) -> None:
    """The browser takes the graphics card away."""
    canvas = "document.getElementById('canvas').getContext('webgl2')"
    page.evaluate(f"{canvas}.getExtension('WEBGL_lose_context').loseContext()")


def make_path(page: Any) -> None:
    """Two viewpoints."""
    if page.locator("#b-more").is_visible():
        page.click("#b-more")
    page.click("#b-path")
    for camera in (0, 4):
        page.evaluate(f"streamlod.setCamera({camera})")
        page.click("#path-menu >> text=Add this view")


def offer(page: Any) -> None:
    """What a slow device is told."""
    page.evaluate("""async () => {
      document.querySelectorAll("style").forEach((style) => style.remove());
      const { toast } = await import("/ui/page.js");
      toast("This device is slow at drawing this scene", 60_000, { label: "Let the server draw", act: () => {} });
    }""")


# Controls hide from a hand that rests, which on a busy machine it does between two steps.
AWAKE = ".idle .chrome:not(:focus-within, :hover) { opacity: 1 !important; pointer-events: auto !important }"
LONG_ACTS = {"lose": lose, "paths": make_path, "offer": offer}


def act(page: Any, shot: Shot) -> None:
    """What a person does."""
    verb, _, what = shot.act.partition(":")
    if verb == "button":
        press = page.tap if shot.size == PHONE else page.click  # a page that is touched speaks of no keys
        if shot.live and what != "#b-more" and page.locator("#b-more").is_visible():
            press("#b-more")  # the tools of a small page are a sheet
        press(what)
    elif verb == "hover":
        page.hover(what)
        page.wait_for_timeout(1500)
    elif verb == "key":
        page.wait_for_function("streamlod.state.viewers !== null")
        page.keyboard.press(what)
        page.locator("#source img").wait_for()
    elif verb == "leave":
        shot.behaviour.leave = (1000, "the stream was deleted")
    elif verb == "wheel":
        page.mouse.move(640, 300)
        for _ in range(int(what) // 250):
            page.mouse.wheel(0, 250)
    elif verb == "js":
        page.evaluate(what)
    elif verb == "wait":
        page.wait_for_timeout(int(what))
    elif verb in LONG_ACTS:
        LONG_ACTS[verb](page)
    elif verb == "rig":
        page.click("#b-cameras")
        page.click("#camera-menu button >> nth=0")
        page.mouse.move(640, 400)
        page.mouse.wheel(0, 700)


def take(browser: Any, shot: Shot, clip: Clip, files: Path, out: Path, slower: float) -> None:
    """One picture into `out`, of a page whose processor is `slower` times slower."""
    hand = {"has_touch": True, "is_mobile": True} if shot.size == PHONE else {}
    page = browser.new_page(viewport={"width": shot.size[0], "height": shot.size[1]}, color_scheme=shot.theme, **hand)
    if slower > 1:
        page.context.new_cdp_session(page).send("Emulation.setCPUThrottlingRate", {"rate": slower})
    if shot.act == "no-webgl":
        page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    with serving(create_app(clip, shot.behaviour, files)) as url:
        page.goto(url + shot.address)
        if shot.live:
            page.wait_for_function("window.streamlod?.state.version >= 2", timeout=20_000)
        page.add_style_tag(content="#toast { visibility: hidden }" + AWAKE)
        act(page, shot)
        page.wait_for_timeout(700 if shot.live else 1500)
        if not shot.act.startswith("hover"):
            page.mouse.move(shot.size[0] / 2, shot.size[1] / 2)  # controls hide from a hand that rests
        page.wait_for_timeout(400)
        if not shot.stop:
            page.screenshot(path=out / f"{shot.name}.png")
    if shot.stop:
        page.wait_for_timeout(900)
        page.screenshot(path=out / f"{shot.name}.png")
    page.close()


def recorded(file: Path) -> Clip:
    """The first frames of a recording."""
    decoder = SceneDecoder()
    states: list[Scene] = []
    with SlodReader(file) as reader:
        for packet in reader.packets():
            decoder.push(packet)
            scene = decoder.scene
            if scene and len(set(decoder.versions)) == 1:
                states = [state for state in states if state.version < scene.version] + [scene]
            if len(states) > 30:
                break
    return Clip([replace(state, version=number, keyframe=0) for number, state in enumerate(states)])


def main() -> None:
    """Take all, or those whose name holds --only."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="folder for the pictures")
    parser.add_argument("--slower", type=float, default=1.0, help="times that the page's processor is slower")
    parser.add_argument("--only", default="", help="parts of the names wanted")
    parser.add_argument(
        "--scene", type=Path, metavar="FILE.slod", help="a recording to show instead of a made-up scene"
    )
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    clip = recorded(arguments.scene) if arguments.scene else make_clip(make_scene(1500), 31)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        files = Path(folder)
        clip.write(files / "clip.slod")
        browser = playwright.chromium.launch(executable_path=chromium_path(), args=TEST_FLAGS)
        for shot in shots():
            if any(part in shot.name for part in arguments.only.split(",")):
                take(browser, shot, clip, files, arguments.out, arguments.slower)
        browser.close()


if __name__ == "__main__":
    main()
