"""What is given up while things move: no holes, quick answers, and everything back at rest."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image

from streamlod.codec.container import SlodWriter
from tests.client.web.miniserver import Behaviour, Clip, create_app, make_clip, serving
from tests.client.web.scenes import make_scene
from tests.client.web.watching import KEEP_TOASTS, WAIT, eventually, psnr, said, shows

pytestmark = pytest.mark.browser

ANCHORS = 5000  # 20 000 splats
DRAW = """async ([cases, number]) => {
  const { walkRecords } = await import("/decode/container.js"), { loadKernel } = await import("/decode/expand.js");
  const { Engine } = await import("/view/engine.js"), { Renderer } = await import("/view/renderer.js");
  const { fromCamera } = await import("/view/camera.js");
  const engine = new Engine(await loadKernel(await (await fetch("/decode/kernel.wasm")).arrayBuffer()));
  const bytes = new Uint8Array(await (await fetch("/files/clip.slod")).arrayBuffer());
  for (const { offset, size } of walkRecords(bytes)) engine.push(bytes.subarray(offset, offset + size));
  const camera = engine.scene.header.cameras[number], pose = fromCamera(camera, 3.2);
  const canvas = Object.assign(document.createElement("canvas"), { width: camera.width, height: camera.height });
  const renderer = new Renderer(canvas), { rotation: r, position: p } = pose, k = camera.intrinsics;
  renderer.background = [...engine.scene.header.background];
  const translation = [0, 1, 2].map((i) => -r[3 * i] * p[0] - r[3 * i + 1] * p[1] - r[3 * i + 2] * p[2]);
  const out = [];
  for (const { share, levels, ...others } of cases) {
    const picture = engine.picture({ position: p, rotation: r, levels });
    renderer.update(picture.rows, picture.spans);
    renderer.setOrder(picture.order);
    renderer.missing = picture.missing;
    const seen = { rotation: r, translation, focal: [k[0], k[4]], principal: [k[2], k[5]], range: pose.distance };
    renderer.draw({ ...seen, ...others, share });
    out.push({ png: canvas.toDataURL().split(",")[1], drawn: renderer.count });
  }
  renderer.destroy();
  return out;
}"""


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server of a standing scene of 20 000 splats, and of the file it comes from."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "blank.html").write_text("<!doctype html><link rel=icon href=/favicon.svg>")
    clip = make_clip(make_scene(ANCHORS), 2)
    with SlodWriter(folder / "clip.slod") as writer:
        writer.append(clip.key())
    with serving(create_app(clip, Behaviour(newest=0), folder)) as url:
        yield url


def image(png: str) -> np.ndarray:
    """[H,W,3] in [0, 1]."""
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB"), np.float64) / 255


def test_what_is_left_covers_what_is_left_out(page: Any, url: str) -> None:
    """A third and a tenth of the splats, and a level less: no background shows where there was something."""
    page.goto(f"{url}/files/blank.html")
    cases = [(1, 3), (0.3, 3), (0.08, 3), (1, 2), (1, 1)]
    drawn = page.evaluate(DRAW, [[{"share": share, "levels": levels} for share, levels in cases], 2])
    assert drawn[0]["drawn"] > 15_000
    full = image(drawn[0]["png"])
    background = np.array([0.08, 0.09, 0.12])
    solid = np.abs(full - background).max(axis=2) > 0.15
    for (share, levels), result in zip(cases, drawn, strict=True):
        picture = image(result["png"])
        holes = (np.abs(picture - background).max(axis=2) < 0.05)[solid].mean()
        assert holes < 0.01, (share, levels)
    assert 0 < drawn[2]["drawn"] < 0.15 * drawn[0]["drawn"], "the graphics card gets a tenth of the splats"


def detail(picture: np.ndarray) -> float:
    """Mean difference of neighbours."""
    return float(np.abs(np.diff(picture, axis=1)).mean())


def test_a_lens_blurs_what_is_not_looked_at(page: Any, url: str) -> None:
    """Nothing gets lighter or darker by it, and what is as far away as what is looked at stays sharp."""
    page.goto(f"{url}/files/blank.html")
    lenses = [{}, {"lens": 0.05}, {"lens": 0.05, "range": 1000}]
    drawn = page.evaluate(DRAW, [[{"share": 1, "levels": 3, **lens} for lens in lenses], 2])
    sharp, focused, blurred = (image(result["png"]) for result in drawn)
    assert detail(blurred) < 0.5 * detail(sharp)
    assert detail(blurred) < detail(focused) < detail(sharp)
    for picture in (focused, blurred):
        assert np.abs(picture.mean((0, 1)) - sharp.mean((0, 1))).max() < 0.02


SLOW_DRAG = """async () => {
  const canvas = document.getElementById("canvas"), waits = [], widths = [];
  const frame = () => new Promise((resolve) => requestAnimationFrame(resolve));
  const at = (type, clientX) =>
    canvas.dispatchEvent(new PointerEvent(type, { pointerId: 1, clientX, clientY: 200, bubbles: true }));
  canvas.setPointerCapture = () => {};
  at("pointerdown", 200);
  for (let i = 0; i < 60; i++) {
    const begin = performance.now();
    at("pointermove", 200 + 3 * i);
    await frame(); // in which it is drawn
    await frame(); // which comes once the graphics process is not behind any more
    waits.push(performance.now() - begin);
    widths.push(canvas.width);
  }
  at("pointerup", 380);
  return { waits, widths };
}"""

COUNT_RESIZES = """
window.resizes = 0;
new MutationObserver((changes) => { resizes += changes.length; })
  .observe(document.getElementById("canvas"), { attributeFilter: ["width"] });
"""


@pytest.mark.timeout(300)  # a busy machine drags more than once
def test_a_slow_device_answers_and_refines_at_rest(page: Any, url: str) -> None:
    """Four times slower, 20 000 splats: a drag is answered, and what rests has full resolution and all splats again."""
    page.set_viewport_size({"width": 640, "height": 480})
    page.goto(url)
    shows(page, "s.version === 0 && s.splats > 15000")
    session = page.context.new_cdp_session(page)
    session.send("Emulation.setCPUThrottlingRate", {"rate": 4})
    splats = page.evaluate("streamlod.state.splats")
    page.evaluate(COUNT_RESIZES)

    def drag() -> None:
        page.evaluate("resizes = 0")
        dragged = page.evaluate(SLOW_DRAG)
        waits, widths = (sorted(dragged[what][-20:]) for what in ("waits", "widths"))
        # In time, or all is done for it: a pause of the machine is a rest, after which one picture is whole again.
        assert waits[10] < 500 or widths[10] < 400, dragged
        assert page.evaluate("resizes") < 20, "steps of quality, but no picture in full between two moves"

    eventually(drag)  # what else the machine does makes pauses, too
    width = "document.getElementById('canvas').width"
    page.wait_for_function(f"{width} === 640", **WAIT)
    assert page.evaluate("streamlod.state.splats") == splats


# A graphics card that takes 200 ms for a picture. With a third one, and with another size of what is being drawn, a
# page stands still until it is done.
LATE_CARD = """
window.standstills = [];
const begun = new Map(), { fenceSync, getSyncParameter } = WebGL2RenderingContext.prototype;
const drawing = () => [...begun.values()].filter((at) => performance.now() - at < 200).length;
WebGL2RenderingContext.prototype.fenceSync = function (...all) {
  const fence = fenceSync.apply(this, all);
  if (drawing() > 1) standstills.push("a third picture");
  begun.set(fence, performance.now());
  return fence;
};
WebGL2RenderingContext.prototype.getSyncParameter = function (fence, name) {
  return performance.now() - begun.get(fence) < 200 ? this.UNSIGNALED : getSyncParameter.call(this, fence, name);
};
const width = Object.getOwnPropertyDescriptor(HTMLCanvasElement.prototype, "width");
Object.defineProperty(HTMLCanvasElement.prototype, "width", { ...width, set(to) {
  if (this.id === "canvas" && drawing()) standstills.push("another size");
  width.set.call(this, to);
} });
"""


def test_the_page_never_stands_still_for_the_graphics_card(page: Any, url: str) -> None:
    """It takes fewer pictures, and other sizes of them only when none is being drawn."""
    page.add_init_script(LATE_CARD)
    page.goto(url)
    shows(page, "s.version === 0")
    page.evaluate(COUNT_RESIZES)
    page.evaluate(SLOW_DRAG)
    page.wait_for_function("resizes > 1 && document.getElementById('canvas').width === 320", **WAIT)
    assert page.evaluate("standstills") == []


WARP = """async () => {
  const { walkRecords } = await import("/decode/container.js"), { loadKernel } = await import("/decode/expand.js");
  const { Engine } = await import("/view/engine.js"), { Renderer } = await import("/view/renderer.js");
  const { Warp } = await import("/view/warp.js"), { fromCamera, orbit } = await import("/view/camera.js");
  const { dot, row } = await import("/lib/vectors.js");
  const engine = new Engine(await loadKernel(await (await fetch("/decode/kernel.wasm")).arrayBuffer()));
  const bytes = new Uint8Array(await (await fetch("/files/clip.slod")).arrayBuffer());
  for (const { offset, size } of walkRecords(bytes)) engine.push(bytes.subarray(offset, offset + size));
  const camera = engine.scene.header.cameras[2], [width, height] = [camera.width, camera.height];
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  const renderer = new Renderer(canvas), warp = new Warp(renderer), k = camera.intrinsics;
  renderer.background = [...engine.scene.header.background];
  const first = fromCamera(camera, 3.2), second = orbit(first, [0, -1, 0], 0.12, 0.03);
  const seen = (pose) => ({ rotation: pose.rotation, range: pose.distance, focal: [k[0], k[4]], principal: [k[2], k[5]],
    translation: [0, 1, 2].map((i) => -dot(row(pose.rotation, i), pose.position)) });
  const load = (pose) => {
    const picture = engine.picture({ ...pose, levels: Infinity });
    renderer.update(picture.rows, picture.spans);
    renderer.setOrder(picture.order);
  };
  const png = () => canvas.toDataURL().split(",")[1];
  const out = {};
  load(first);
  renderer.draw(seen(first));
  out.first = png();
  warp.keep(seen(first), width, height);
  const { drawElements } = renderer.gl;
  renderer.gl.drawElements = () => { throw new Error("splats were drawn"); };
  warp.draw(seen(first));
  out.same = png();
  warp.draw(seen(second));
  out.warped = png();
  renderer.gl.drawElements = drawElements;
  out.due = [warp.isDue(seen(first), false), warp.isDue(seen(orbit(first, [0, -1, 0], 1, 0)), false)];
  warp.costMs = 1e9;
  out.late = warp.isDue(seen(first), true);
  load(second);
  renderer.draw(seen(second));
  out.second = png();
  warp.destroy();
  renderer.destroy();
  return out;
}"""


def test_the_last_picture_is_moved_by_its_depth(page: Any, url: str) -> None:
    """From where it was drawn it is that picture; from beside it nearly what is drawn there, without one splat."""
    page.goto(f"{url}/files/blank.html")
    out = page.evaluate(WARP)
    first, same, warped, second = (image(out[name]) for name in ("first", "same", "warped", "second"))
    assert psnr(same, first) > 45
    unmoved, moved = psnr(first, second), psnr(warped, second)
    assert moved > unmoved + 5, (unmoved, moved)
    assert out["due"] == [False, True], "a new picture is due from far away only"
    assert out["late"] is False, "a picture that takes long is drawn rarely"


SLOW_CARD = """() => {
  window.counts = { splats: 0, moved: 0 };
  const { drawElements, drawArrays } = WebGL2RenderingContext.prototype;
  WebGL2RenderingContext.prototype.drawElements = function (...all) {
    counts.splats++;
    for (const end = performance.now() + 300; performance.now() < end; );
    return drawElements.apply(this, all);
  };
  WebGL2RenderingContext.prototype.drawArrays = function (...all) {
    counts.moved++;
    return drawArrays.apply(this, all);
  };
}"""


@pytest.mark.timeout(300)
def test_a_device_that_is_too_slow_moves_its_last_picture(page: Any, clip: Clip) -> None:
    """Where splats take 0.3 s, the last picture answers a drag, all splats rest; the server's way is offered."""
    page.add_init_script(f"({SLOW_CARD})()")
    page.add_init_script(KEEP_TOASTS)
    with serving(create_app(clip, Behaviour(newest=0))) as url:
        page.goto(url)
        shows(page, "s.version === 0")

        def drag() -> None:
            page.evaluate(SLOW_DRAG)
            page.evaluate("counts = { splats: 0, moved: 0 }")
            page.evaluate(SLOW_DRAG)
            counts = page.evaluate("counts")
            assert counts["moved"] > 3 * counts["splats"] > 0 or counts["splats"] == 0 < counts["moved"], counts

        eventually(drag)
        said(page, "This device is slow")
        page.wait_for_function("document.getElementById('canvas').width === 320", **WAIT)
        page.evaluate("document.getElementById('toast-button').click()")  # it may have gone by itself meanwhile
        page.wait_for_url("**thin=1**", **WAIT)
        page.goto("about:blank")
    page.complaints.forgive("WebSocket connection to")


SLOW_PAGE = """
const ask = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (call) => ask((now) => {
  for (const end = performance.now() + 250; performance.now() < end; );
  call(now);
});
"""


def test_nothing_is_slow_at_drawing_before_there_is_a_picture(page: Any, clip: Clip) -> None:
    """A page that is busy while it waits for a scene does not say that it is slow at drawing one."""
    page.add_init_script(SLOW_PAGE)
    page.add_init_script(KEEP_TOASTS)
    with serving(create_app(clip, Behaviour(state="starting", newest=0))) as url:
        page.goto(url)
        shows(page, "s.phase === 'waiting' && s.version === null")
        page.evaluate(SLOW_DRAG.replace("i < 60", "i < 12"))
        assert page.evaluate("toasts") == []
        page.goto("about:blank")
    page.complaints.forgive("WebSocket connection to")


HIDES_AMID_DRAWING = """
const ask = window.requestAnimationFrame.bind(window), asked = [], { drawElements } = WebGL2RenderingContext.prototype;
window.requestAnimationFrame = (call) => ask((now) => (document.hidden ? asked.push(call) : call(now)));
window.hide = (hidden) => { // as browsers do
  Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
  document.dispatchEvent(new Event("visibilitychange"));
  if (!hidden) asked.splice(0).forEach(ask);
};
WebGL2RenderingContext.prototype.drawElements = function (...all) {
  drawElements.apply(this, all);
  if (window.hides) setTimeout(hide, 0, true);
  window.hides = false;
};
"""


def test_who_looked_at_another_tab_is_not_called_slow(page: Any, clip: Clip) -> None:
    """Nothing is drawn in a hidden tab; how long it was hidden is not how long drawing takes."""
    page.add_init_script(HIDES_AMID_DRAWING)
    page.add_init_script(KEEP_TOASTS)
    behaviour = Behaviour(newest=1)
    with serving(create_app(clip, behaviour)) as url:
        page.goto(url)
        shows(page, "s.version === 1")
        page.evaluate("hides = true")
        behaviour.newest = 2
        page.wait_for_function("document.hidden", polling=50, **WAIT)
        page.wait_for_timeout(2000)  # were it drawing, it would be called slow after 1.6 s
        page.evaluate("hide(false)")
        behaviour.newest = 3
        shows(page, "s.version === 3")
        page.evaluate("new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        assert not any("slow" in toast for toast in page.evaluate("toasts"))
        page.goto("about:blank")
    page.complaints.forgive("WebSocket connection to")
