"""Streams in the scenes of other engines: the example pages with Spark, three.js and PlayCanvas from npm."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi import FastAPI
from fastapi.staticfiles import StaticFiles
from PIL import Image
from starlette.routing import Mount

from streamlod.codec.container import SlodWriter
from streamlod.codec.encoder import encode_keyframe
from streamlod.core.camera import look_at, pinhole
from streamlod.core.render import cpu
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from streamlod.core.scene.keyframe import as_keyframe
from tests.client.web.miniserver import WEB, Behaviour, Clip, create_app, make_clip, serving
from tests.client.web.scenes import make_scene
from tests.client.web.watching import comes_to_show, eventually, picture, psnr, reference, shows

pytestmark = [pytest.mark.browser, pytest.mark.long]

PACKAGES = Path(__file__).parent / "node_modules"
EXAMPLES = Path(__file__).parents[3] / "examples" / "web"
WIDTH, HEIGHT, FOCAL = 320, 180, 230.0
RED, GREEN = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
STEP = 8  # versions between those that are looked at


ENGINES = {"spark": "@sparkjsdev/spark", "playcanvas": "playcanvas", "three": "three"}  # example page, its package
AGREEMENT = 35  # decibels between the page's own picture and another engine's
# The engines draw the scene whether it changed or not, which takes a processor alone at sixty pictures a second.
SELDOM = """
  const soon = window.requestAnimationFrame;
  window.requestAnimationFrame = (draw) => setTimeout(() => soon(draw), 300);
"""


@pytest.fixture(scope="module")
def clip(kernel: bytes) -> Clip:
    """Two seconds pass between the frames that are looked at, for which a viewer stands at the middle camera."""
    scene = make_scene(400, view_dependent=False)
    target, up = np.array([0.0, -0.35, 0.0]), np.array([0.0, -1.0, 0.0])
    cameras = tuple(
        pinhole(
            f"cam{i:02d}", (FOCAL, FOCAL), (WIDTH / 2, HEIGHT / 2), (WIDTH, HEIGHT),
            look_at(np.array([3.2 * np.sin(angle), -0.9, -3.2 * np.cos(angle)]), target, up),
        )
        for i, angle in enumerate((-0.4, 0.0, 0.4))
    )  # fmt: skip
    clip = make_clip(replace(scene, header=replace(scene.header, cameras=cameras, fps=0.5)), 2 * STEP + 1)
    return replace(clip, frame_ns=2_000_000_000 // STEP)


@contextmanager
def visiting(chromium: Any) -> Iterator[Any]:
    """A page of the size of the rig's pictures; what it says on the console goes into `lines`."""
    context = chromium.new_context(viewport={"width": WIDTH, "height": HEIGHT}, reduced_motion="reduce")
    page = context.new_page()
    page.add_init_script(SELDOM)
    page.lines = []
    page.on("console", lambda message: page.lines.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: page.lines.append(f"error: {error}"))
    yield page
    context.close()
    harmless = ("GPU stall due to ReadPixels", "No available adapters", "running under WebGL2 backend")
    assert [line for line in page.lines if not any(text in line for text in harmless)] == []


@pytest.fixture
def visit(chromium: Any) -> Iterator[Any]:
    """See `visiting`."""
    with visiting(chromium) as page:
        yield page


@dataclass(frozen=True)
class Recorded:
    """A recording `clip.slod` in a folder, and [H,W,3] in [0, 1] of each of its states with the example's cubes."""

    folder: Path
    pictures: list[np.ndarray]


def recorded(chromium: Any, clip: Clip, folder: Path, packets: list[bytes], states: list[Scene]) -> Recorded:
    """What all engines have to show: the page's own pictures of `states`, into which the cubes are drawn."""
    with SlodWriter(folder / "clip.slod") as writer:
        for packet in packets:
            writer.append(packet)
    with visiting(chromium) as page, serving(create_app(clip, Behaviour(), folder)) as url:
        own = pages_own(page, url, states)
        page.goto("about:blank")  # it would miss the server
    return Recorded(folder, [with_cubes(one, state) for one, state in zip(own, states, strict=True)])


@pytest.fixture(scope="module")
def recording(chromium: Any, clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Three frames."""
    packets = [clip.key(), *(clip.residual(version, version + STEP) for version in (0, STEP))]
    return recorded(chromium, clip, tmp_path_factory.mktemp("frames"), packets, clip.states[::STEP])


@pytest.fixture(scope="module")
def growing(chromium: Any, clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Three keyframes, the second of which has more Gaussians than the others."""
    small = clip.states[0]
    large = replace(make_scene(1200, view_dependent=False), header=small.header, weights=small.weights)
    states = [small, as_keyframe(large, STEP), as_keyframe(small, 2 * STEP)]
    packets = [encode_keyframe(state, time_ns=number * 2_000_000_000) for number, state in enumerate(states)]
    return recorded(chromium, clip, tmp_path_factory.mktemp("growing"), packets, states)


def with_examples(app: FastAPI, engine: str) -> FastAPI:
    """The server, with the example pages and the packages that they import."""
    if not (PACKAGES / ENGINES[engine]).exists():
        pytest.skip(f"{ENGINES[engine]} is not installed: npm install --prefix tests/client/web")
    folders = {"node_modules/streamlod": WEB, "node_modules": PACKAGES, "": EXAMPLES}
    app.router.routes[:0] = [Mount(f"/web/{place}", StaticFiles(directory=path)) for place, path in folders.items()]
    return app


def pages_own(page: Any, url: str, states: list[Scene]) -> list[np.ndarray]:
    """[H,W,3] each, in [0, 1]: what streamlod's own page shows of these states of a recording."""
    page.goto(f"{url}/?ui=0&quality=high&src=files/clip.slod")
    shows(page, "s.window && s.version >= 0")
    page.evaluate("streamlod.pause()")
    found = []
    for state in states:
        page.evaluate(f"streamlod.seek({state.version})")
        shows(page, f"s.version === {state.version} && ['paused', 'ended'].includes(s.phase)")
        page.evaluate("streamlod.setCamera(1)")
        comes_to_show(page, reference(state, state.header.cameras[1]))
        found.append(picture(page))
    return found


def with_cubes(own: np.ndarray, state: Scene) -> np.ndarray:
    """The page's picture as it is with the example's cubes in the scene; NaN along their edges."""
    expected, camera = own.copy(), state.header.cameras[1]
    behind = np.asarray(cpu.render(expand(state, camera.centre), camera, GREEN.astype(np.float32)).image, np.float64)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    for side, inside in ((-1, np.broadcast_to(RED, own.shape)), (1, behind)):
        away = np.maximum(abs(x - WIDTH / 2 - side * 0.1 * FOCAL), abs(y - HEIGHT / 2))  # from its middle
        expected[away < 17] = np.nan
        expected[away < 8] = inside[away < 8]
    return expected


def foreign(page: Any) -> np.ndarray:
    """[H,W,3] in [0, 1]: what the window shows."""
    image = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    return np.asarray(image, np.float64) / 255


def likeness(expected: np.ndarray, shown: np.ndarray) -> float:
    """In decibels, but for what is NaN."""
    known = ~np.isnan(expected)
    return psnr(shown[known], expected[known])


def comes_to_agree(page: Any, expected: np.ndarray) -> None:
    """The window shows that picture, sooner or later."""

    def look() -> None:
        found = likeness(expected, foreign(page))
        assert found >= AGREEMENT, found

    eventually(look)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_recording_plays_among_things_of_the_scene(visit: Any, clip: Clip, recording: Recorded, engine: str) -> None:
    """Each frame as on the page, again from the begin; a cube before the splats hides them, one behind is hidden."""
    pictures = recording.pictures
    assert all(likeness(a, b) < AGREEMENT - 5 for a, b in itertools.pairwise(pictures))
    with serving(with_examples(create_app(clip, Behaviour(), recording.folder), engine)) as url:
        visit.goto(f"{url}/web/{engine}.html?stream=/files/clip.slod")
        for picture_then in [*pictures, pictures[0]]:
            comes_to_agree(visit, picture_then)
        visit.goto("about:blank")  # it would miss the server


@pytest.mark.parametrize("engine", ENGINES)
def test_a_live_stream_plays_as_it_comes(visit: Any, clip: Clip, recording: Recorded, engine: str) -> None:
    """Version after version, whenever the server has one."""
    behaviour = Behaviour(newest=STEP, fps=1000)
    with serving(with_examples(create_app(clip, behaviour, recording.folder), engine)) as url:
        _, before, after = recording.pictures
        visit.goto(f"{url}/web/{engine}.html")
        comes_to_agree(visit, before)
        behaviour.newest = 2 * STEP
        comes_to_agree(visit, after)
        assert likeness(before, foreign(visit)) < AGREEMENT - 5
        visit.goto("about:blank")


@pytest.mark.parametrize("engine", ENGINES)
def test_keyframes_with_more_gaussians_than_all_before_are_shown_whole(
    visit: Any, clip: Clip, growing: Recorded, engine: str
) -> None:
    """Buffers are made anew when a keyframe needs more than they hold, and what is left over of them is not drawn."""
    pictures = growing.pictures
    assert likeness(pictures[0], pictures[1]) < AGREEMENT - 5
    with serving(with_examples(create_app(clip, Behaviour(), growing.folder), engine)) as url:
        visit.goto(f"{url}/web/{engine}.html?stream=/files/clip.slod")
        for picture_then in [*pictures, pictures[1]]:
            comes_to_agree(visit, picture_then)
        visit.goto("about:blank")
