"""Whether the page tells the truth about time: a live stream of uneven frames, a real server that restarts, Chromium.

    python -m tests.bench.truth_bench [--seconds 600 --restarts 2]

A stand-in for training takes 1.2 s for one frame and 8 s for the next, and notes when each was filmed and published;
all else is real. Once a second the page keeps what it says, also while the server is away, and between the restarts
it looks half a minute back. Prints how far delay, lag and the bar's clock were off at most, and where nothing was said.
What was published within half a second may still be on its way.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import tempfile
import time
from contextlib import ExitStack
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from unittest.mock import patch

from playwright.sync_api import sync_playwright

from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.packet.info import peek
from streamlod.core.scene.residual import difference
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings, WorkerSettings
from streamlod.server.worker import supervisor
from streamlod.server.worker.messages import Sender, Tag, receive_resume
from streamlod.server.worker.process import HEARTBEAT_SECONDS
from streamlod.server.worker.training import show_again
from tests.client.web.conftest import TEST_FLAGS, chromium_path
from tests.client.web.scenes import make_scene, moved
from tests.server.conftest import running
from tests.server.ports import held_ports

FRAME_SECONDS = (1.2, 8.0)
ON_ITS_WAY = 0.5  # s
AWAY, BACK = 10.0, 20.0  # s: the server between two lives, the viewer in the past
_LOG = "TRUTH_BENCH_LOG"
KEEP = """() => {
  window.samples = [];
  const text = (id) => document.getElementById(id).textContent;
  setInterval(() => {
    const { phase, mode, position, behindSeconds: lag, latencyMs } = streamlod.state;
    const delay = latencyMs === null ? null : latencyMs / 1000;
    const words = { chip: text("status-text"), shown: text("status-latency"), clock: text("t-time") };
    samples.push({ at: Date.now() / 1000, phase, mode, position, lag, delay, ...words });
  }, 1000);
}"""


def paced(spec: StreamSpec, pipe: Connection, *_: object) -> None:
    """In place of `run_worker`: frames of a moving scene, each filmed when its "training" begins."""

    def publish(filmed_ns: int, packet: bytes | None, first: bool) -> None:
        with Path(os.environ[_LOG]).open("a") as log:
            log.write(json.dumps([first, scene.version, filmed_ns / 1e9, time.time()]) + "\n")
        if packet is not None:
            sender.send(Tag.PACKET, packet)
            sender.send(Tag.REPORT, {"version": scene.version, "done": number + 1})

    sender, resume = Sender(pipe), receive_resume(pipe)
    scene = None
    if resume.packets:
        scene = show_again(resume, sender)
        publish(peek(resume.packets[-1]).time_ns, None, first=True)
    for number in itertools.count(resume.frames):
        filmed_ns, end = time.time_ns(), time.monotonic() + FRAME_SECONDS[number % 2]
        while (left := end - time.monotonic()) > 0:
            sender.send(Tag.HEARTBEAT, (0).to_bytes(8))
            time.sleep(min(left, HEARTBEAT_SECONDS))
        if scene is None:
            scene = make_scene(60)
            publish(filmed_ns, encode_keyframe(scene, time_ns=filmed_ns), first=True)
        else:
            before, scene = scene, moved(scene)
            change = encode_residual(before, difference(before, scene), time_ns=filmed_ns)
            publish(filmed_ns, change, first=False)


class Truth:
    """What was published when, of all epochs."""

    def __init__(self, log: Path) -> None:
        self.frames: list[tuple[tuple[int, int], float, float]] = []  # position, filmed, published
        epoch = 0
        for line in log.read_text().splitlines():
            first, version, filmed, published = json.loads(line)
            epoch += first
            self.frames.append(((epoch, version), filmed, published))
        self.filmed = {position: filmed for position, filmed, _ in self.frames}

    def published(self, at: float) -> list[tuple[tuple[int, int], float, float]]:
        """What there was at a time."""
        return [frame for frame in self.frames if frame[2] <= at]

    def delay(self, at: float, when: float) -> float:
        """Age at `at` of the picture that was the newest at `when`."""
        return at - self.published(when)[-1][1]

    def lag(self, position: dict[str, int], when: float) -> float:
        """How much later than a position the newest picture at `when` was filmed."""
        return max(0.0, self.published(when)[-1][1] - self.filmed[position["epoch"], position["version"]])

    def length(self, when: float) -> float:
        """What was filmed, without the time between epochs."""
        epochs = itertools.groupby(self.published(when), key=lambda frame: frame[0][0])
        spans = [[filmed for _, filmed, _ in frames] for _, frames in epochs]
        return sum(span[-1] - span[0] for span in spans)


def errors(truth: Truth, sample: dict[str, Any]) -> dict[str, float | None]:
    """How far each figure is off, s; None where nothing was said."""
    at = sample["at"]
    whens = (at, at - ON_ITS_WAY)
    live = sample["mode"] == "live"
    shown, clock = _seconds(sample["shown"]), _seconds(sample["clock"])

    def off(said: float | None, *true: float) -> float | None:
        return None if said is None else min(abs(said - each) for each in true)

    delays, lags = [truth.delay(at, w) for w in whens], [truth.lag(sample["position"], w) for w in whens]
    found = {"delay": off(sample["delay"], *delays), "delay in words": off(shown, *delays)} if live else {}
    clocks = [truth.length(w) for w in whens] if live else lags
    return found | {"lag": off(sample["lag"], *lags), "clock": off(clock, *clocks)}


def _seconds(text: str) -> float | None:
    """Seconds of `3.2 s` or `1:02.5`, with or without a minus."""
    text = text.removesuffix(" old").strip("\u2212- s")
    if not text:
        return None
    minutes, _, seconds = text.rpartition(":")
    return 60 * float(minutes or 0) + float(seconds)


def watch(seconds: float, restarts: int, folder: Path) -> list[dict[str, Any]]:
    """What the page said, once a second."""
    settings = Settings(state=folder / "state", worker=WorkerSettings(spare=False))
    camera = {"name": "stage", "url": "rtsp://127.0.0.1:9/stage"}
    spec = StreamSpec(job=TrainJob(live={"cameras": [camera], "fps": 30}))
    with ExitStack() as stack, patch.object(supervisor, "run_worker", paced), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium_path(), args=TEST_FLAGS)
        page = browser.new_page(viewport={"width": 320, "height": 240}, reduced_motion="reduce")
        (port,) = stack.enter_context(held_ports(1))
        life = seconds / (restarts + 1)
        for number in range(restarts + 1):
            with running(settings, spec, port=port) as server:
                end = time.monotonic() + life
                if number == 0:
                    page.goto(f"{server.url}/?sway=0&quality=low")
                    page.wait_for_function(
                        "streamlod.state.version > 3 && streamlod.state.phase === 'live'", timeout=90_000
                    )
                    page.evaluate(KEEP)
                page.wait_for_timeout(1000 * (life / 2))
                for _ in range(3):
                    page.keyboard.press("j")
                    page.wait_for_timeout(1000)
                page.wait_for_timeout(1000 * BACK)
                page.keyboard.press("End")
                page.wait_for_timeout(1000 * max(0.0, end - time.monotonic()))
            if number < restarts:
                page.wait_for_timeout(1000 * AWAY)
        samples: list[dict[str, Any]] = page.evaluate("samples")
        browser.close()
    return samples


def main() -> None:
    """Watch and compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--restarts", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="folder for what was said and what was true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = options.keep or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        os.environ[_LOG] = str(folder / "published.txt")
        samples = watch(options.seconds, options.restarts, folder)
        (folder / "said.json").write_text(json.dumps(samples))
        report(Truth(folder / "published.txt"), samples)


def report(truth: Truth, samples: list[dict[str, Any]]) -> None:
    """Print, for each figure, the samples, the largest error and the moment of it, and how often it was not said."""
    begin = samples[0]["at"]
    found = [(sample, errors(truth, sample)) for sample in samples]
    for name in ("delay", "delay in words", "lag", "clock"):
        said = [(each[name], sample) for sample, each in found if each.get(name) is not None]
        silent = [sample for sample, each in found if name in each and each[name] is None]
        worst, sample = max(said, key=lambda pair: pair[0] or 0.0)
        beyond = sum((error or 0.0) > ON_ITS_WAY for error, _ in said)
        print(f"{name}: {len(said)} times, off by {worst:.2f} s at most (at {sample['at'] - begin:.0f} s, {sample}), "
              f"beyond {ON_ITS_WAY} s {beyond} times; not said {len(silent)} times, "
              f"while {sorted({sample['phase'] for sample in silent})}")  # fmt: skip


if __name__ == "__main__":
    main()
