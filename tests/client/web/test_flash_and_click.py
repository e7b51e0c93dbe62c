"""Picture and sound of one instant, from cameras that film now through training and a server to Chromium."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from streamlod.core.synthetic import SyntheticSpec, cameras
from streamlod.core.synthetic.render import render_image
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.clicks import write_sounding
from tests.client.web.test_sound import LISTEN, TAP
from tests.client.web.watching import WAIT, shows
from tests.server.conftest import running
from tests.server.ingest.rig import NEEDS_FFMPEG, rtsp, sending
from tests.server.ports import free_ports

FPS = 2
SPEC = SyntheticSpec(cameras=3, frames=1, width=64, height=36, seed=2, fps=FPS)
BRIEF = {"keyframe.steps": 100, "keyframe.growth_interval": 25, "predict.minimum_steps": 8}
FILMED = 30  # trained pictures, about half of which flash

# Keeps what was drawn, so that it can be read after its frame.
KEEP = """
  const open = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, how) {
    return open.call(this, kind, { ...how, preserveDrawingBuffer: true });
  };
"""
# When bright pictures are reached, by the clock of the page; how bright they are is read from the canvas then.
LOOK = """() => {
  window.flashes = [];
  const small = new OffscreenCanvas(16, 9).getContext("2d", { willReadFrequently: true });
  const look = (at) => {
    small.drawImage(document.getElementById("canvas"), 0, 0, 16, 9);
    const greens = small.getImageData(0, 0, 16, 9).data.filter((_, i) => i % 4 === 1);
    if (greens.reduce((sum, value) => sum + value, 0) / greens.length > 100) flashes.push(at);
  };
  streamlod.on("picture", ({ overMs }) => {
    if (overMs === null) return; // seen from elsewhere
    const at = performance.now() + overMs;
    setTimeout(() => requestAnimationFrame(() => requestAnimationFrame(() => look(at))), overMs);
  });
}"""
# How much later than the newest five flashes their clicks were heard, ms; a flash while sound is silent has none.
OFFSETS = """() => flashes
  .map((at) => heard.map((click) => click - at).sort((a, b) => Math.abs(a) - Math.abs(b))[0])
  .filter((off) => Math.abs(off) < 500).slice(-5)"""
IN_STEP = f"""() => {{
  const offs = ({OFFSETS})().map(Math.abs).sort((a, b) => a - b);
  return offs.length === 5 && offs[2] <= 40;
}}"""
# Plays again from a picture on where the page has not come to be in step after a while: it may have been slow to begin.
AGAIN = f"""(first) => {{
  if (!(performance.now() - window.begun < 25_000)) {{
    window.begun = performance.now();
    streamlod.seek(first);
  }}
  return ({IN_STEP})();
}}"""


def _film(folder: Path) -> list[Path]:
    """What each camera films: the room, which flashes in the first picture of each second, with a click."""
    files = []
    for number, camera in enumerate(cameras(SPEC)):
        room = render_image(SPEC, 0, number) // 2
        files.append(folder / f"{camera.name}.mp4")
        write_sounding(files[-1], 10, pictures=[room if at % FPS else room + 120 for at in range(10 * FPS)], fps=FPS)
    return files


def _rig(ports: list[int]) -> dict[str, Any]:
    """Cameras that push to us; the second one is heard."""
    pushing = [
        {
            "name": camera.name,
            "source": f"rtsp+listen://127.0.0.1:{port}/live",
            "width": camera.width,
            "height": camera.height,
            "intrinsics": camera.intrinsics.tolist(),
            "world_to_camera": camera.world_to_camera.tolist(),
        }
        for camera, port in zip(cameras(SPEC), ports, strict=True)
    ]
    return {"fps": FPS, "depth_bounds": [0.5, 12], "cameras": pushing, "sound": pushing[1]["name"]}


@pytest.mark.browser
@pytest.mark.slow  # and wants a machine to itself: where the page draws late, pictures are late
@pytest.mark.timeout(1500)  # where the worker compiles first
@NEEDS_FFMPEG
def test_a_flash_of_cameras_is_seen_when_its_click_is_heard(page: Any, tmp_path: Path) -> None:
    """Played from the stream's past once the cameras have gone: training would take the page's time."""
    files, ports = _film(tmp_path), free_ports(SPEC.cameras)
    page.add_init_script(TAP)
    page.add_init_script(KEEP)
    job = TrainJob(live=_rig(ports), preset="live", points="random", set=BRIEF)
    with running(Settings(), StreamSpec(job=job)) as server:
        server.wait(lambda stream: stream["ingest"] is not None)
        begin = ("-start_time_realtime", str(time.time_ns() // 1000))  # the cameras' clocks agree
        loop = dict.fromkeys(range(len(files)), ("-stream_loop", "-1"))
        with ExitStack() as filming:
            for file, port in zip(files, ports, strict=True):
                filming.enter_context(sending(file, (*begin, *rtsp(port)), before=loop))
            first = server.wait(lambda stream: stream["state"] == "live", seconds=600)["version"]
            server.wait(lambda stream: stream["version"] >= first + FILMED, seconds=400)
        page.goto(f"{server.url}/?quality=low&sway=0")
        shows(page, "s.sound !== null && s.version !== null")
        page.locator("#t-sound").evaluate("button => button.click()")
        page.evaluate(LISTEN)
        page.evaluate(LOOK)
        try:
            page.wait_for_function(AGAIN, arg=first, polling=1000, **WAIT)
        except Exception as error:
            raise AssertionError(f"{page.evaluate(OFFSETS)}, {page.evaluate('streamlod.state')}") from error
        page.goto("about:blank")
