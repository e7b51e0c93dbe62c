"""Drawing with WebGPU: the same pictures as with WebGL2, a sort that is one, counted work, and ways out."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from streamlod.codec.container import SlodWriter
from streamlod.codec.encoder import encode_keyframe
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.keyframe import as_keyframe
from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.scenes import make_scene
from tests.client.web.watching import WAIT, amid_the_scene, eventually, picture, psnr, reference, shows

pytestmark = [pytest.mark.browser, pytest.mark.long]

LIKENESS = 45  # decibels
ADDRESS = "?ui=0&quality=high&webgpu="
KEEP_DEVICE = """
const { requestDevice } = GPUAdapter.prototype;
GPUAdapter.prototype.requestDevice = async function (...all) {
  return (window.device = await requestDevice.apply(this, all));
};
"""
REFUSALS = {
    "no adapter": "navigator.gpu.requestAdapter = async () => null",
    "an error for an adapter": "navigator.gpu.requestAdapter = async () => { throw new TypeError('blocked') }",
    "no device": "GPUAdapter.prototype.requestDevice = async () => { throw new DOMException('no', 'OperationError') }",
    "no context": """
      const { getContext } = HTMLCanvasElement.prototype;
      HTMLCanvasElement.prototype.getContext = function (kind, ...all) {
        return kind === "webgpu" ? null : getContext.call(this, kind, ...all);
      };
    """,
    "a scene that is too large": """
      Object.defineProperty(GPUSupportedLimits.prototype, "maxStorageBufferBindingSize", { get: () => 30_000 });
    """,
}
SORT = """async (cases) => {
  const { GpuSort } = await import("/view/gpusort.js");
  const device = await (await navigator.gpu.requestAdapter()).requestDevice(), wrong = [];
  device.addEventListener("uncapturederror", ({ error }) => wrong.push(error.message));
  const sort = await GpuSort.create(device);
  const read = async (source, count) => {
    const size = 4 * Math.max(count, 1), copy = device.createBuffer({ size, usage: 9 }); // to map, and to copy to
    const encoder = device.createCommandEncoder();
    encoder.copyBufferToBuffer(source, 0, copy, 0, size);
    device.queue.submit([encoder.finish()]);
    await copy.mapAsync(1);
    return new Uint32Array(copy.getMappedRange().slice(0)).subarray(0, count);
  };
  for (const [count, kinds, leftOut] of cases) {
    let state = 12345;
    const next = () => (state = (Math.imul(state, 1664525) + 1013904223) >>> 0);
    const keys = Uint32Array.from({ length: count }, () => {
      const key = Math.trunc(((next() >>> 8) % kinds) * (0xffffff / Math.max(kinds - 1, 1)));
      return (next() >>> 8) % 100 < leftOut ? 0xffffffff : key;
    });
    const kept = [...keys.keys()].filter((i) => keys[i] !== 0xffffffff);
    const expected = kept.sort((a, b) => keys[a] - keys[b] || a - b);
    sort.reserve(count);
    sort.expect(count);
    device.queue.writeBuffer(sort.buffers.unsorted.keys, 0, keys);
    device.queue.writeBuffer(sort.buffers.unsorted.numbers, 0, Uint32Array.from(keys.keys()));
    const encoder = device.createCommandEncoder(), pass = encoder.beginComputePass();
    sort.encode(pass);
    pass.end();
    device.queue.submit([encoder.finish()]);
    const [indices, instances, , , , , shown] = await read(sort.sizes, 7);
    const found = await read(sort.buffers.sorted.numbers, shown);
    const name = `${count} keys of ${kinds}, ${leftOut} % left out`;
    if (shown !== expected.length) wrong.push(`${name}: ${shown} instead of ${expected.length}`);
    else if (found.some((number, i) => number !== expected[i])) wrong.push(`${name}: another order`);
    const quads = (instances * indices) / 6;
    if (count && (quads < shown || quads >= shown + 256)) wrong.push(`${name}: ${quads} quads`);
  }
  device.destroy();
  return wrong;
}"""
COUNT_WORK = """
window.work = { buffers: 0, bytes: 0, uploaded: 0, dispatches: 0, groups: 0, draws: 0, submits: 0 };
const count = (kind, name, act) => {
  const old = kind.prototype[name];
  kind.prototype[name] = function (...all) {
    act(...all);
    return old.apply(this, all);
  };
};
count(GPUDevice, "createBuffer", ({ size }) => { work.buffers++; work.bytes += size; });
count(GPUQueue, "writeBuffer", (buffer, at, data) => { work.uploaded += data.byteLength; });
count(GPUQueue, "submit", () => work.submits++);
count(GPUComputePassEncoder, "dispatchWorkgroups", (groups) => { work.dispatches++; work.groups += groups; });
count(GPURenderPassEncoder, "drawIndexedIndirect", () => work.draws++);
"""
MANY = """async () => {
  const { createGpuRenderer } = await import("/view/webgpu.js");
  const frame = Object.assign(document.createElement("canvas"), { width: 64, height: 48 }), count = 200_000;
  document.body.append(frame);
  const renderer = await createGpuRenderer(await navigator.gpu.requestAdapter(), frame);
  const rows = Math.ceil(count / 512), data = new Uint32Array(rows * 512 * 12), numbers = new Float32Array(data.buffer);
  for (let i = 0; i < count; i++) {
    const mean = [(i * 0.618) % 1 - 0.5, (i * 0.755) % 1 - 0.5, 1 + (i * 0.57) % 1];
    numbers.set([...mean, 0.5, 1e-6, 0, 0, 1e-6, 0, 1e-6], 12 * i);
  }
  renderer.update(rows, [{ first: 0, data }]);
  renderer.setOrder(Uint32Array.from({ length: count }, (_, i) => i));
  const rotation = [1, 0, 0, 0, 1, 0, 0, 0, 1];
  const draw = async (x) => {
    renderer.draw({ rotation, translation: [x, 0, 0], focal: [60, 60], principal: [32, 24] });
    await renderer.device.queue.onSubmittedWorkDone();
  };
  await draw(0);
  const before = { ...work };
  let turns = 0, isDone = false;
  const drawn = draw(0.1).then(() => (isDone = true));
  while (!isDone && turns < 1000) {
    turns++;
    await new Promise((resolve) => setTimeout(resolve));
  }
  await drawn;
  const picture = Object.fromEntries(Object.entries(work).map(([name, value]) => [name, value - before[name]]));
  renderer.destroy();
  return { picture, turns, bytes: before.bytes / count };
}"""
BOTH = """async ([cases, number]) => {
  const { walkRecords } = await import("/decode/container.js"), { loadKernel } = await import("/decode/expand.js");
  const { Engine } = await import("/view/engine.js"), { Renderer } = await import("/view/renderer.js");
  const { createGpuRenderer } = await import("/view/webgpu.js"), { fromCamera } = await import("/view/camera.js");
  const kernel = await loadKernel(await (await fetch("/decode/kernel.wasm")).arrayBuffer());
  const bytes = new Uint8Array(await (await fetch("/files/clip.slod")).arrayBuffer());
  const packets = walkRecords(bytes).map(({ offset, size }) => bytes.subarray(offset, offset + size));
  const drawn = async (isGpu) => {
    const engine = new Engine(kernel), canvas = document.createElement("canvas"), out = [];
    document.body.append(canvas);
    engine.push(packets[0]);
    const camera = engine.scene.header.cameras[number], k = camera.intrinsics;
    const { rotation: r, position: p } = fromCamera(camera, 3.2);
    Object.assign(canvas, { width: camera.width, height: camera.height });
    const adapter = await navigator.gpu.requestAdapter();
    const renderer = isGpu ? await createGpuRenderer(adapter, canvas) : new Renderer(canvas);
    renderer.background = [...engine.scene.header.background];
    const translation = [0, 1, 2].map((i) => -r[3 * i] * p[0] - r[3 * i + 1] * p[1] - r[3 * i + 2] * p[2]);
    const show = ({ levels = 3, moved = 1, ...more }, overMs) => {
      const picture = engine.picture({ position: p, rotation: r, levels, unsorted: isGpu });
      renderer.update(picture.rows, picture.spans, overMs);
      if (picture.order) renderer.setOrder(picture.order);
      renderer.missing = picture.missing;
      renderer.advance = () => (renderer.moved = moved);
      const seen = { rotation: r, translation, focal: [k[0], k[4]], principal: [k[2], k[5]], range: 3.2 };
      renderer.draw({ ...seen, ...more });
      out.push(renderer.canvas.toDataURL().split(",")[1]);
    };
    for (const one of cases) show(one, null);
    engine.push(packets[1]);
    show({ moved: 0.4 }, 1000);
    show({ moved: 1 }, null);
    renderer.destroy();
    return out;
  };
  return [await drawn(false), await drawn(true)];
}"""


def image(png: str) -> np.ndarray:
    """[H,W,3] in [0, 1]."""
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB"), np.float64) / 255


def screen(page: Any) -> np.ndarray:
    """[H,W,3] in [0, 1]: what the window shows."""
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), np.float64) / 255


def comes_to_equal(page: Any, expected: np.ndarray, seen: Callable[[Any], np.ndarray] = picture) -> None:
    """The page shows that picture, to 45 dB."""

    def look() -> None:
        found = psnr(seen(page), expected)
        assert found >= LIKENESS, found

    eventually(look)


def draws_with(page: Any, webgpu: bool) -> None:
    """Wait until the page draws with WebGPU, or with WebGL2."""
    page.wait_for_function(f"!!document.querySelector('.surface') === {str(webgpu).lower()}", **WAIT)


@pytest.fixture
def folder(tmp_path: Path, clip: Clip) -> Path:
    """An empty page, and two states of the clip that differ."""
    (tmp_path / "blank.html").write_text("<!doctype html><link rel=icon href=/favicon.svg><body>")
    with SlodWriter(tmp_path / "clip.slod") as writer:
        writer.append(clip.key())
        writer.append(clip.residual(0, 5))
    return tmp_path


@pytest.mark.parametrize("webgpu", [False, True])
def test_same_picture_as_python(page_webgpu: Any, clip: Clip, webgpu: bool) -> None:
    """Every camera of the rig, a place amid the scene, and later frames; what is on the screen is what is captured."""
    page, behaviour = page_webgpu, Behaviour(newest=7, fps=60)
    with serving(create_app(clip, behaviour)) as url:
        page.goto(f"{url}/{ADDRESS}{int(webgpu)}")
        shows(page, "s.version === 7")
        draws_with(page, webgpu)
        scene = clip.states[7]
        for number in (0, 2, 4):
            page.evaluate(f"streamlod.setCamera({number})")
            comes_to_equal(page, reference(scene, scene.header.cameras[number]))
        comes_to_equal(page, reference(scene, scene.header.cameras[4]), screen)
        page.evaluate("streamlod.setCamera('0.1,-0.3,-0.4, 0,0,1, 0,1,0, 1, 1.25, 0,0, 1')")
        comes_to_equal(page, reference(scene, amid_the_scene(page)))
        behaviour.newest = 12
        shows(page, "s.version === 12")
        page.evaluate("streamlod.setCamera(1)")
        comes_to_equal(page, reference(clip.states[12], scene.header.cameras[1]))


def test_both_leave_out_cover_and_move_alike(page_webgpu: Any, clip: Clip, folder: Path) -> None:
    """A share of the splats, a level less, another exposure, a lens, a near border, and the way from state to state."""
    cases = [
        {}, {"share": 0.3}, {"share": 0.08}, {"levels": 2}, {"levels": 1, "share": 0.5},
        {"exposure": [0.8, 1.1, 1.2, 0.05, 0, -0.02]}, {"lens": 0.1},
    ]  # fmt: skip
    with serving(create_app(clip, Behaviour(), folder)) as url:
        page_webgpu.goto(f"{url}/files/blank.html")
        pictures = [[image(png) for png in pngs] for pngs in page_webgpu.evaluate(BOTH, [cases, 2])]
    for case, one, other in zip([*cases, "on the way", "there"], *pictures, strict=True):
        assert psnr(one, other) >= LIKENESS, case
    assert psnr(pictures[1][-2], pictures[1][-1]) < LIKENESS, "on the way it looks different"


def test_sort_is_that_of_the_processor(page_webgpu: Any, clip: Clip, folder: Path) -> None:
    """Few keys and many, around the sizes of workgroups and blocks, equal ones, and ones that are left out."""
    counts = (0, 1, 2, 255, 256, 257, 4095, 4096, 4097, 100_000, 3)
    cases = [(count, kinds, out) for count in counts for kinds, out in ((1 << 24, 0), (1, 0), (5, 30))]
    with serving(create_app(clip, Behaviour(), folder)) as url:
        page_webgpu.goto(f"{url}/files/blank.html")
        assert page_webgpu.evaluate(SORT, [*cases, (5000, 100, 100)]) == []


def test_two_hundred_thousand_splats_take_ten_dispatches_and_no_upload(
    page_webgpu: Any, clip: Clip, folder: Path
) -> None:
    """Another view of them: a few numbers are sent, the work is that of a linear sort, no memory is taken.

    However long it takes to draw, the page answers meanwhile.
    """
    page_webgpu.add_init_script(COUNT_WORK)
    with serving(create_app(clip, Behaviour(), folder)) as url:
        page_webgpu.goto(f"{url}/files/blank.html")
        found = page_webgpu.evaluate(MANY)
    blocks = -(-200_000 // 4096)
    assert found["picture"] == {
        "buffers": 0, "bytes": 0, "uploaded": 128, "dispatches": 10, "draws": 1, "submits": 1,
        "groups": -(-200_000 // 256) + 3 * (2 * blocks + 1),
    }  # fmt: skip
    assert found["turns"] > 5, "of the page, while the picture was drawn"
    assert found["bytes"] < 115, "bytes of the graphics card's memory for each splat"


def test_keyframes_of_other_sizes_are_shown_whole(page_webgpu: Any, clip: Clip, tmp_path: Path) -> None:
    """Twelve hundred anchors after four hundred, and four hundred again."""
    page, small = page_webgpu, clip.states[0]
    large = replace(make_scene(1200), header=small.header, weights=small.weights)
    states: list[Scene] = [small, as_keyframe(large, 1), as_keyframe(small, 2)]
    with SlodWriter(tmp_path / "sizes.slod") as writer:
        for number, state in enumerate(states):
            writer.append(encode_keyframe(state, time_ns=number * 1_000_000_000))
    with serving(create_app(clip, Behaviour(), tmp_path)) as url:
        page.goto(f"{url}/{ADDRESS}1&src=files/sizes.slod&t=0")
        for number in (0, 1, 2, 1):
            shows(page, "s.window")
            page.evaluate(f"streamlod.seek({number}); streamlod.pause()")
            shows(page, f"s.version === {number}")
            page.evaluate("streamlod.setCamera(2)")
            comes_to_equal(page, reference(states[number], small.header.cameras[2]))
        draws_with(page, True)


def test_frames_take_no_memory_of_the_graphics_card(page_webgpu: Any, clip: Clip) -> None:
    """Frames create no buffers, and destroy() gives the device back."""
    page = page_webgpu
    page.add_init_script(COUNT_WORK + KEEP_DEVICE)
    with serving(create_app(clip, Behaviour(fps=20))) as url:
        page.goto(f"{url}/{ADDRESS}1")
        shows(page, "s.version >= 1")
        draws_with(page, True)
        before = page.evaluate("work.buffers")
        shows(page, "s.version >= 15")
        assert page.evaluate("work.buffers") == before
        page.evaluate("streamlod.destroy()")
        assert page.evaluate("device.lost.then(({ reason }) => reason)") == "destroyed"
        assert page.locator(".surface").count() == 0


def test_a_lost_device_leads_to_webgl(page_webgpu: Any, clip: Clip) -> None:
    """The same picture goes on, with new frames, and nothing is asked of anybody."""
    page, behaviour = page_webgpu, Behaviour(newest=3, fps=60)
    page.add_init_script(KEEP_DEVICE)
    with serving(create_app(clip, behaviour)) as url:
        page.goto(f"{url}/{ADDRESS}1")
        shows(page, "s.version === 3")
        draws_with(page, True)
        page.evaluate("streamlod.setCamera(2)")
        comes_to_equal(page, reference(clip.states[3], clip.states[3].header.cameras[2]))
        page.evaluate("device.destroy()")
        draws_with(page, False)
        comes_to_equal(page, reference(clip.states[3], clip.states[3].header.cameras[2]))
        assert page.locator("#card").is_hidden()
        behaviour.newest = 6
        shows(page, "s.version === 6")
        comes_to_equal(page, reference(clip.states[6], clip.states[3].header.cameras[2]))


@pytest.mark.parametrize("refusal", REFUSALS)
def test_a_refusal_leads_to_webgl(page_webgpu: Any, clip: Clip, refusal: str) -> None:
    """Whatever is refused, and however, the picture comes."""
    page = page_webgpu
    page.add_init_script(REFUSALS[refusal])
    with serving(create_app(clip, Behaviour(newest=3))) as url:
        page.goto(f"{url}/{ADDRESS}1")
        shows(page, "s.version === 3")
        draws_with(page, False)
        page.evaluate("streamlod.setCamera(2)")
        comes_to_equal(page, reference(clip.states[3], clip.states[3].header.cameras[2]))


def test_emulated_webgpu_is_taken_only_when_asked_for(page_webgpu: Any, clip: Clip) -> None:
    """A processor draws faster with WebGL2."""
    with serving(create_app(clip, Behaviour(newest=3))) as url:
        page_webgpu.goto(f"{url}/?ui=0&quality=high")
        shows(page_webgpu, "s.version === 3")
        draws_with(page_webgpu, False)
