"""`python -m tests.client.web.screenshots OUT`: the page's states and sizes as pictures, for people to look at."""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from codec.container import SlodReader, SlodWriter
from codec.decoder import SceneDecoder
from core.scene.anchors import Scene
from tests.client.web.conftest import CHROMIUM_FLAGS, chromium_path
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
    training = Behaviour(state="starting", progress=(0.4, "step 400 of 1000"))
    many = Behaviour(newest=30, streams=("main", "stage left", "rehearsal"))
    return [
        Shot("live-desktop-dark", many),
        Shot("live-desktop-light", many, theme="light"),
        Shot("live-tablet", full, TABLET),
        Shot("readme", full, (960, 540), address="/?quality=high"),
        Shot("live-phone-dark", full, PHONE),
        Shot("live-phone-light", many, PHONE, "light"),
        Shot("phone-landscape", full, (844, 390)),
        Shot("statistics", full, act="button:#b-stats"),
        Shot("statistics-phone", full, PHONE, act="button:#b-stats"),
        Shot("cameras", full, act="button:#b-cameras"),
        Shot("cameras-phone", full, PHONE, act="button:#b-cameras"),
        Shot("rig", full, act="rig"),
        Shot("quality", full, act="button:#b-quality"),
        Shot("help", full, act="button:#b-help"),
        Shot("help-phone-light", full, PHONE, "light", act="button:#b-help"),
        Shot("streams", many, act="button:#stream-name"),
        Shot("paused", full, act="js:streamlod.seek(12); streamlod.pause()"),
        Shot("recording", full, address="/?src=files/clip.slod"),
        Shot("stalled", full, act="wait:3500"),
        Shot("training", training, live=False),
        Shot("training-phone-light", training, PHONE, "light", live=False),
        Shot("waiting", Behaviour(state="idle"), live=False),
        Shot("version", Behaviour(version=2), live=False),
        Shot("denied", Behaviour(close=(4401, "The token has expired")), live=False, theme="light"),
        Shot("missing", Behaviour(close=(4404, "there is no such stream")), live=False),
        Shot("failed", Behaviour(close=(1009, "a message was too big")), live=False),
        Shot("reconnecting", full, stop=True),
        Shot("unreachable", Behaviour(close=(1013, "The server is full")), live=False),
        Shot("no-webgl", full, address="/?", act="no-webgl", live=False),
        Shot("embedded", full, (480, 270), address="/?embed=1"),
        Shot("bare", full, (480, 270), address="/?embed=1&ui=0"),
    ]


def take(browser: Any, shot: Shot, clip: Clip, files: Path, out: Path) -> None:
    """One picture into `out`."""
    page = browser.new_page(
        viewport={"width": shot.size[0], "height": shot.size[1]}, color_scheme=shot.theme, has_touch=shot.size == PHONE
    )
    if shot.act == "no-webgl":
        page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    with serving(create_app(clip, shot.behaviour, files)) as url:
        page.goto(url + shot.address)
        if shot.live:
            page.wait_for_function("window.streamlod?.state.version >= 10", timeout=20_000)
        page.evaluate("document.getElementById('toast').remove()" if shot.live else "0")
        verb, _, what = shot.act.partition(":")
        if verb == "button":
            if shot.live and page.locator("#b-more").is_visible():
                page.click("#b-more")  # the tools of a small page are a sheet
            page.click(what)
        elif verb == "js":
            page.evaluate(what)
        elif verb == "wait":
            page.wait_for_timeout(int(what))
        elif verb == "rig":
            page.click("#b-cameras")
            page.click("#camera-menu button >> nth=0")
            page.mouse.move(640, 400)
            page.mouse.wheel(0, 700)
        page.wait_for_timeout(700 if shot.live else 1500)
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
    parser.add_argument("--only", default="", help="part of the names wanted")
    parser.add_argument(
        "--scene", type=Path, metavar="FILE.slod", help="a recording to show instead of a made-up scene"
    )
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    clip = recorded(arguments.scene) if arguments.scene else make_clip(make_scene(2500), 31)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        files = Path(folder)
        with SlodWriter(files / "clip.slod") as writer:
            writer.append(clip.key())
            for version in range(1, len(clip.states)):
                writer.append(clip.residual(version - 1, version))
        browser = playwright.chromium.launch(executable_path=chromium_path(), args=CHROMIUM_FLAGS)
        for shot in shots():
            if arguments.only in shot.name:
                take(browser, shot, clip, files, arguments.out)
        browser.close()


if __name__ == "__main__":
    main()
