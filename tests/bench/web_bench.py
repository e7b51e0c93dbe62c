"""`python -m tests.bench.web_bench [FILE.slod ...]`: the page in headless Chromium.

Decode, network, sort, drawing, joining. Files are recordings to measure besides the synthetic streams. Drawing is in
software (SwiftShader) and takes all cores there are: leave the machine alone meanwhile.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

from streamlod.codec.container import SlodWriter
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.scene.anchors import AnchorLevel, Scene, append_rows
from streamlod.core.scene.octree import morton_key
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Limits, Settings
from tests.client.web.conftest import CHROMIUM_FLAGS, chromium_path
from tests.client.web.miniserver import Behaviour, create_app, make_clip, serving
from tests.client.web.scenes import make_scene
from tests.client.web.test_quality import SLOW_DRAG
from tests.codec import scenes as codec_scenes
from tests.server.conftest import running

TIMED_SEEK = """async (version) => {
  const begin = performance.now();
  const shown = new Promise((resolve) => {
    const stop = streamlod.on("picture", (p) => p.version === version && (stop(), resolve()));
  });
  streamlod.seek(version);
  await shown;
  return performance.now() - begin;
}"""
# How long the page stands still at most, in milliseconds, while the hand drags for some seconds.
STANDSTILL = """async (seconds) => {
  const canvas = document.getElementById("canvas"), { port1, port2 } = new MessageChannel();
  const end = performance.now() + 1000 * seconds, at = (type, clientX) =>
    canvas.dispatchEvent(new PointerEvent(type, { pointerId: 1, clientX, clientY: 200, bubbles: true }));
  canvas.setPointerCapture = () => {};
  at("pointerdown", 200);
  const drag = () => {
    if (performance.now() > end) return at("pointerup", 200);
    at("pointermove", 200 + 100 * Math.sin(performance.now() / 200));
    requestAnimationFrame(drag);
  };
  drag();
  let longest = 0;
  for (let last = performance.now(); last < end; last = performance.now()) {
    await new Promise((resolve) => { port1.onmessage = resolve; port2.postMessage(0); });
    longest = Math.max(longest, performance.now() - last);
  }
  return longest;
}"""
FRAMES, ROUNDS, JOINS, SEEKS = 12, 4, 5, 30
MEASURE = """async ([address, rounds]) => {
  const { walkRecords } = await import("/decode/container.js");
  const { Engine } = await import("/view/engine.js");
  const { loadKernel } = await import("/decode/expand.js");
  const { fromCamera, homeCamera, orbit, rigUp } = await import("/view/camera.js");
  const kernel = await loadKernel(await (await fetch("/decode/kernel.wasm")).arrayBuffer());
  const file = new Uint8Array(await (await fetch(address)).arrayBuffer());
  const packets = walkRecords(file).map(({ offset, size, kind }) => {
    return { key: kind === 0, bytes: file.slice(offset, offset + size) };
  });
  const keys = packets.filter(({ key }) => key), residuals = packets.filter(({ key }) => !key).slice(0, 40);
  const times = { key: [], residual: [], expandFirst: [], expandAll: [], expandChanged: [], sort: [] };
  const timed = (list, act) => {
    const start = performance.now();
    act();
    list.push(performance.now() - start);
  };
  let anchors = 0, splats = 0, header = null;
  for (let round = 0; round < rounds; round++) {
    const engine = new Engine(kernel);
    timed(times.key, () => keys.forEach(({ bytes }) => engine.push(bytes)));
    header = engine.scene.header;
    let pose = fromCamera(header.cameras[homeCamera(header.cameras)], 3);
    const view = () => ({ position: pose.position, rotation: pose.rotation, levels: 16 });
    times.expandFirst.push(engine.picture(view()).expandMs);
    for (const { bytes } of residuals) {
      timed(times.residual, () => engine.push(bytes));
      const picture = engine.picture(view());
      times.expandChanged.push(picture.expandMs);
      times.sort.push(picture.sortMs);
      ({ anchors, splats } = picture);
    }
    pose = orbit(pose, rigUp(header.cameras), 0.3, 0);
    times.expandAll.push(engine.picture(view()).expandMs);
    if (round === rounds - 1) {
      const { expander } = engine;
      const rows = 256, { pointers, inputs, columns, slots } = expander;
      const start = performance.now();
      for (let i = 0; i < 10 * anchors; i += rows) {
        kernel.dense(rows / 2, pointers[4], inputs, pointers[0], pointers[1], pointers[5], 2, 1);
        kernel.dense(rows / 2, pointers[5], 32, pointers[2], pointers[3], pointers[6], columns / 16, 0);
        kernel.sigmoid(pointers[6], rows, 4 * columns, Math.ceil(7 * slots / 4));
      }
      times.mlp = [(performance.now() - start) / 10];
      times.layers = [inputs, 32, 11 * slots];
    }
  }
  const sum = (list) => list.reduce((total, { bytes }) => total + bytes.length, 0);
  return { times, anchors, splats, slots: header.slots, viewDependent: header.viewDependent,
    keyBytes: sum(keys), residualBytes: residuals.map(({ bytes }) => bytes.length) };
}"""
ORBIT = """async (seconds) => {
  const key = { code: "ArrowLeft", key: "ArrowLeft", bubbles: true };
  document.body.dispatchEvent(new KeyboardEvent("keydown", key));
  await new Promise((resolve) => setTimeout(resolve, 500));
  let drawn = 0;
  const stop = streamlod.on("frame", () => drawn++);
  const start = performance.now();
  await new Promise((resolve) => setTimeout(resolve, 1000 * seconds));
  stop();
  const canvas = document.getElementById("canvas");
  const fps = 1000 * drawn / (performance.now() - start);
  return { fps, size: `${canvas.width}x${canvas.height}`, splats: streamlod.state.splats };
}"""
NEWEST_SHOWN = "((s) => s?.window && s.version === s.window.newest.version)(window.streamlod?.state)"
WATCH_JOIN = """addEventListener("DOMContentLoaded", () => {
  const stage = document.getElementById("stage");
  const shown = () => requestAnimationFrame(() => requestAnimationFrame(() => (window.joinedMs = performance.now())));
  new MutationObserver((changes, observer) => {
    if (!stage.hasAttribute("data-shown")) return;
    observer.disconnect();
    shown();
  }).observe(stage, { attributes: true });
});"""


def median(values: list[float]) -> float:
    """The upper median of a list."""
    return sorted(values)[len(values) // 2]


def tiled(scene: Scene, times: int) -> Scene:
    """`scene` several times side by side."""
    levels = []
    for level in scene.levels:
        shifts = [np.array([64 * i, 0, 0], np.int32) for i in range(times)]
        wide = reduce(append_rows, (replace(level, voxel=level.voxel + shift) for shift in shifts))
        order = np.argsort(morton_key(wide.voxel), kind="stable")
        levels.append(AnchorLevel(*(getattr(wide, name)[order] for name in AnchorLevel.__slots__)))
    return replace(scene, levels=tuple(levels))


def record_synthetic(file: Path, slots: int, features: int, view_dependent: bool) -> None:
    """A stream of about 23 000 anchors of which a tenth change from frame to frame."""
    scene = tiled(codec_scenes.make_scene((1500, 9000, 20_000), slots=slots, features=features), 4)
    if not view_dependent:
        weights = replace(scene.weights, hidden_weight=scene.weights.hidden_weight[:features])
        scene = replace(scene, header=replace(scene.header, view_dependent=False), weights=weights)
    states, residuals = codec_scenes.steps(scene, FRAMES)
    with SlodWriter(file) as writer:
        writer.append(encode_keyframe(scene, time_ns=0))
        for number, residual in enumerate(residuals):
            writer.append(encode_residual(states[number], residual, time_ns=number * 33_333_333))


def codec_times(page: Any, url: str, title: str, file: Path) -> None:
    """Decode, network, packing and sort of a recording, without a worker's or a socket's share."""
    found = page.evaluate(MEASURE, [f"{url}/files/{file.name}", ROUNDS])
    times = found["times"]
    views = "view-dependent" if found["viewDependent"] else "the same from all views"
    print(f"{title}: {found['anchors']} anchors, K = {found['slots']}, {views}, {found['splats']} splats drawn")
    print(f"  keyframe {found['keyBytes'] / 1000:.0f} kB, residual {median(found['residualBytes']) / 1000:.1f} kB")
    rows = [
        ("decode keyframe", "key"),
        ("decode residual", "residual"),
        (f"MLP {'-'.join(map(str, times['layers']))}, all anchors", "mlp"),
        ("expand all of a keyframe", "expandFirst"),
        ("expand what changed", "expandChanged"),
        ("sort and index", "sort"),
    ]
    if found["viewDependent"]:
        rows.insert(4, ("expand all for a new view", "expandAll"))
    for label, name in rows:
        print(f"  {label:32s} {median(times[name]):8.2f} ms (least {min(times[name]):.2f})", flush=True)


def draw_rate(browser: Any, address: str, title: str, settle_s: float = 0.0) -> None:
    """Frames a second while orbiting at 640x480; auto quality finds its step in the `settle_s` before that."""
    page = browser.new_page(viewport={"width": 640, "height": 480})
    page.goto(address)
    page.wait_for_function("window.streamlod?.state.version >= 1", timeout=60_000)
    if settle_s:
        page.evaluate(ORBIT, settle_s)
    found = page.evaluate(ORBIT, 4)
    print(f"  {title}: {found['splats']} splats at {found['size']}: {found['fps']:.1f} frames a second", flush=True)
    page.close()


def drag_answers(browser: Any, anchors: int, slower: int) -> None:
    """From a move of the pointer until its picture is drawn, and from the last one until all detail is back.

    The same drag before, with all of the CPU, tells how much of it is the machine's: on one that is busy with other
    things only the ratio says something.
    """
    with serving(create_app(make_clip(make_scene(anchors), 2), Behaviour(newest=0))) as url:
        free = 0.0
        for rate in (1, slower):
            page = browser.new_page(viewport={"width": 640, "height": 480})
            page.goto(url)
            page.wait_for_function("window.streamlod?.state.version === 0", timeout=60_000)
            page.context.new_cdp_session(page).send("Emulation.setCPUThrottlingRate", {"rate": rate})
            splats = page.evaluate("streamlod.state.splats")
            page.wait_for_timeout(2000)  # loading has ended, everything is drawn in full
            waits = page.evaluate(SLOW_DRAG)
            begin = time.monotonic()
            page.wait_for_function("document.getElementById('canvas').width === 640", timeout=60_000)
            rest = time.monotonic() - begin
            still = page.evaluate(STANDSTILL, 5)
            page.close()
            answered = median(waits[-30:])
            free = free or answered
            print(
                f"paused, {splats} splats, CPU {rate} times slower, auto: a drag is answered in {answered:.0f} ms "
                f"(first {waits[0]:.0f}), {answered / free:.1f} times as long as at full speed; "
                f"all is back after {rest:.1f} s; the page stands still for {still:.0f} ms at most",
                flush=True,
            )


def join_time(browser: Any, address: str) -> None:
    """From the navigation to the first picture on the screen, with nothing cached."""
    times = []
    for _ in range(JOINS):
        context = browser.new_context(viewport={"width": 640, "height": 480})
        page = context.new_page()
        page.add_init_script(WATCH_JOIN)
        page.goto(address)
        page.wait_for_function("window.joinedMs", timeout=60_000)
        times.append(page.evaluate("joinedMs"))
        context.close()
    print(f"  join to first picture: {median(times):.0f} ms (least {min(times):.0f})", flush=True)


def thin_seeks(browser: Any, recording: Path) -> None:
    """From the wish for another frame until its picture is on the page, where the server draws."""
    with running(Settings(limits=Limits(thin_viewers=1)), StreamSpec(play=recording, loop=False)) as server:
        server.wait(lambda stream: stream["state"] == "ended")
        page = browser.new_page(viewport={"width": 640, "height": 360})
        page.goto(f"{server.url}/?ui=0")
        page.wait_for_function(NEWEST_SHOWN, timeout=60_000)
        window = page.evaluate("streamlod.state.window")
        retained = np.arange(window["oldest"]["version"], window["newest"]["version"])
        for prepare in ("pause", "play"):
            page.evaluate(f"streamlod.{prepare}()")
            # none twice: it would already be there
            versions = np.random.default_rng(0).permutation(retained)[:SEEKS].tolist()
            times = [page.evaluate(TIMED_SEEK, version) for version in versions]
            label = {"pause": "paused", "play": "while it plays"}[prepare]
            print(
                f"server draws 640x360, {len(retained) + 1} frames, seek {label}: median {median(times):.0f} ms, "
                f"worst of {len(times)} {max(times):.0f} ms",
                flush=True,
            )
        page.close()


def main() -> None:
    """Print all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*", type=Path, help="recordings to measure too")
    parser.add_argument("--drag", action="store_true", help="only how fast a drag is answered on a slow device")
    parser.add_argument("--seek", action="store_true", help="only how fast seeks of FILE are where the server draws")
    arguments = parser.parse_args()
    files = arguments.files
    if arguments.seek:
        with sync_playwright() as playwright:
            flags = [flag for flag in CHROMIUM_FLAGS if "swiftshader" not in flag]
            browser = playwright.chromium.launch(executable_path=chromium_path(), args=[*flags, "--disable-3d-apis"])
            for file in files:
                thin_seeks(browser, file)
            browser.close()
        return
    if arguments.drag:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium_path(), args=CHROMIUM_FLAGS)
            drag_answers(browser, 5000, 4)
            browser.close()
        return
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        browser = playwright.chromium.launch(executable_path=chromium_path(), args=CHROMIUM_FLAGS)
        subjects = {"small header": folder / "small.slod", "the paper's header": folder / "paper.slod"}
        record_synthetic(subjects["small header"], 4, 16, False)
        record_synthetic(subjects["the paper's header"], 10, 32, True)
        for number, file in enumerate(files):
            subjects[file.name] = Path(shutil.copy(file, folder / f"{number}.slod"))
        with serving(create_app(make_clip(make_scene(100), 2), Behaviour(), folder)) as url:
            page = browser.new_page()
            page.goto(f"{url}/favicon.svg")
            for title, file in subjects.items():
                codec_times(page, url, title, file)
            page.close()
        for anchors in (1250, 6250):
            clip = make_clip(make_scene(anchors), 60)
            print(f"live stream of {anchors} anchors, K = 4, orbiting at 640x480:")
            with serving(create_app(clip, Behaviour(fps=15))) as url:
                draw_rate(browser, f"{url}/?ui=0&quality=high", "high")
                draw_rate(browser, f"{url}/?ui=0", "auto", settle_s=6)
                join_time(browser, f"{url}/?ui=0")
        for number, file in enumerate(files):
            print(f"{file.name}, orbiting at 640x480:")
            with serving(create_app(make_clip(make_scene(100), 2), Behaviour(), folder)) as url:
                address = f"{url}/?ui=0&src=files/{number}.slod"
                draw_rate(browser, f"{address}&quality=high", "high")
                draw_rate(browser, address, "auto", settle_s=6)
                join_time(browser, address)
        browser.close()


if __name__ == "__main__":
    main()
