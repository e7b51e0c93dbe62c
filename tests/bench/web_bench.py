"""`python -m tests.bench.web_bench`: the page's decode, MLP, sort and drawing, measured in headless Chromium."""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

from codec.container import SlodWriter
from codec.encoder import encode_keyframe, encode_residual
from codec.packet import PacketKind
from core.anchors import AnchorLevel, Scene, append_rows
from core.octree import morton_key
from tests.client.web.conftest import CHROMIUM_FLAGS, chromium_path
from tests.client.web.miniserver import Behaviour, create_app, make_clip, serving
from tests.client.web.scenes import make_scene
from tests.codec import scenes as codec_scenes

FRAMES = 12
MEASURE = """async ([address, rounds]) => {
  const { walkRecords } = await import("/container.js");
  const { SceneDecoder } = await import("/decoder.js");
  const { Engine } = await import("/engine.js");
  const { loadKernel } = await import("/expand.js");
  const kernel = await loadKernel(await (await fetch("/kernel.wasm")).arrayBuffer());
  const file = new Uint8Array(await (await fetch(address)).arrayBuffer());
  const packets = walkRecords(file).map(({ offset, size }) => file.slice(offset, offset + size));
  const times = { key: [], residual: [], expandAll: [], expandChanged: [], sort: [] };
  const timed = (list, act) => {
    const start = performance.now();
    act();
    list.push(performance.now() - start);
  };
  let anchors = 0, splats = 0;
  for (let round = 0; round < rounds; round++) {
    const engine = new Engine(kernel);
    timed(times.key, () => engine.push(packets[0]));
    const view = { position: [0, -0.9, -3.2 - round * 0.5], rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1], levels: 16, reach: Infinity };
    engine.picture(view);
    for (const packet of packets.slice(1)) {
      timed(times.residual, () => engine.push(packet));
      const picture = engine.picture(view);
      times.expandChanged.push(picture.expandMs);
      times.sort.push(picture.sortMs);
      splats = picture.splats;
    }
    const turned = engine.picture({ ...view, position: [5, -0.9, -3.2] });
    times.expandAll.push(turned.expandMs);
    anchors = engine.summary().anchors;
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
  return { times, anchors, splats, bytes: packets.map((packet) => packet.length) };
}"""


def median(values: list[float]) -> float:
    """Of a list."""
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


def codec_times(page: Any, url: str, slots: int, folder: Path) -> None:
    """Decode, MLP and sort of a scene of about 20 000 anchors."""
    scene = tiled(codec_scenes.make_scene((1500, 9000, 20_000), slots=slots, features=32), 4)
    states, residuals = codec_scenes.steps(scene, FRAMES)

    with SlodWriter(folder / "bench.slod") as writer:
        writer.append(encode_keyframe(scene, time_ns=0))
        for number, residual in enumerate(residuals):
            before = states[number]
            writer.append(encode_residual(before, residual, kind=PacketKind.PREDICTED, time_ns=number + 1))
    found = page.evaluate(MEASURE, [f"{url}/files/bench.slod", 4])
    (folder / "bench.slod").unlink()
    times = found["times"]
    changed = median([sum(len(level.rows) for level in residual.levels) for residual in residuals])
    print(
        f"{found['anchors']} anchors, K = {slots}, {found['splats']} splats drawn, {changed:.0f} anchors change a frame"
    )
    print(f"  keyframe {found['bytes'][0] / 1000:.0f} kB, residual {median(found['bytes'][1:]) / 1000:.1f} kB")
    for label, name in (
        ("decode keyframe", "key"),
        ("decode residual", "residual"),
        (f"MLP {'-'.join(map(str, times['layers']))}, all anchors", "mlp"),
        ("expand all for a new view", "expandAll"),
        ("expand what changed", "expandChanged"),
        ("sort and index", "sort"),
    ):
        print(f"  {label:32s} {median(times[name]):8.2f} ms (least {min(times[name]):.2f})")


def draw_rate(browser: Any, anchors: int) -> None:
    """Frames a second while orbiting a live stream at 640x480."""
    clip = make_clip(make_scene(anchors), 60)
    with serving(create_app(clip, Behaviour(fps=15))) as url:
        page = browser.new_page(viewport={"width": 640, "height": 480})
        page.goto(f"{url}/?ui=0&quality=high")
        page.wait_for_function("window.streamlod?.state.version >= 1", timeout=60_000)
        frames = page.evaluate(
            """async () => {
              let drawn = 0;
              streamlod.on("frame", () => drawn++);
              const start = performance.now();
              const key = { code: "ArrowLeft", key: "ArrowLeft", bubbles: true };
              document.body.dispatchEvent(new KeyboardEvent("keydown", key));
              await new Promise((resolve) => setTimeout(resolve, 4000));
              return 1000 * drawn / (performance.now() - start);
            }"""
        )
        splats = page.evaluate("streamlod.state.splats")
        print(f"drawing {splats} splats at 640x480 while orbiting a live stream: {frames:.1f} frames a second")
        page.close()


def main() -> None:
    """Print all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium_path(), args=CHROMIUM_FLAGS)
        clip = make_clip(make_scene(100), 2)
        with serving(create_app(clip, Behaviour(), Path(folder))) as url:
            page = browser.new_page()
            page.goto(f"{url}/favicon.svg")
            codec_times(page, url, 10, Path(folder))
            page.close()
        for anchors in (1250, 5000):
            draw_rate(browser, anchors)
        browser.close()


if __name__ == "__main__":
    main()
