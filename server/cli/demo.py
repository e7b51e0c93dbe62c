"""`streamlod demo`: the whole product once, with the commands that a user would type.

A synthetic clip is written, served live, watched by a client from a moving viewpoint and from a held-out camera, and
measured against the truth; everything is left in one folder.
"""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import time
import urllib.request
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from streamlod.core.errors import InputError
from streamlod.core.files import write_bytes

_LOG = logging.getLogger(__name__)
_STREAMLOD = sys.executable, "-m", "streamlod.server.cli"
_POLL_SECONDS = 0.5
_START_SECONDS = 120.0
_TRAIN_SECONDS = 600.0


@dataclass(frozen=True, slots=True)
class DemoSettings:
    """The size of the demo, and where it leaves its results.

    Attributes:
        out: folder of the results.
        cameras, frames, size: of the synthetic clip.
        views: training cameras; camera cam00 is held out.
        host, port: where the server listens.
        stay: keep serving at the end until Ctrl-C.
    """

    out: Path = Path("demo-output")
    cameras: int = 7
    frames: int = 15
    size: str = "320x180"
    views: int = 6
    host: str = "127.0.0.1"
    port: int = 8000
    stay: bool = True


def run_demo(settings: DemoSettings) -> None:
    """Run the demo; progress goes to stderr.

    Raises:
        StreamlodError: a step failed; the sentence names it.
    """
    begin = time.monotonic()
    settings.out.mkdir(parents=True, exist_ok=True)
    clip, scene = settings.out / "clip", settings.out / "scene.slod"
    size = f"--cameras {settings.cameras} --frames {settings.frames} --size {settings.size}"
    _step("writing a synthetic clip", "synth", clip, *size.split(), "--overwrite")
    with _server(settings, clip) as base:
        live = base.replace("http", "ws", 1) + "/v1/streams/main/live"
        opened = settings.stay and open_page(base)
        _wait(base, "the first picture", lambda stream: stream["version"] is not None)
        first_picture = time.monotonic() - begin
        _LOG.info("first picture after %.0f s", first_picture)
        film = "--orbit", "--frames", settings.frames, "--out", settings.out / "orbit.mp4"
        _step("watching live, from a moving viewpoint", "view", live, *film)
        stream = _wait(base, "the last frame", lambda stream: stream["state"] == "ended")
        _download(f"{base}/v1/streams/main/bitstream", scene)
        files = "--json", settings.out / "report.json", "--save-images", settings.out / "held-out"
        _step("measuring the held-out camera", "evaluate", scene, clip, "--test", "cam00", *files)
        summary = _summary(settings, scene, stream, first_picture, time.monotonic() - begin)
        (settings.out / "summary.md").write_text(summary)
        sys.stderr.write("\n" + summary)
        if settings.stay:
            sys.stderr.write(f"\n{'Look' if opened else f'Open {base}/ to look'} around; Ctrl-C ends.\n")
            _sleep_until_interrupted()


def open_page(address: str) -> bool:
    """Show the viewer page in the user's browser; False, and the address in the log, where there is no screen."""
    screen = sys.platform in ("darwin", "win32") or bool({"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ))
    if screen and webbrowser.open(address):
        return True
    _LOG.info("the page is at %s/", address)
    return False


def _summary(settings: DemoSettings, scene: Path, stream: dict[str, Any], first_picture: float, total: float) -> str:
    """One page of figures, in Markdown."""
    report = json.loads((settings.out / "report.json").read_text())
    mean, stages = report["mean"], (stream.get("report") or {}).get("seconds") or {}
    rows = [
        ("held-out PSNR (cam00)", f"{mean['psnr']:.2f} dB"),
        ("held-out SSIM", f"{mean['ssim']:.4f}"),
        ("keyframe", f"{mean['keyframe_kilobytes']:.0f} KB"),
        ("predicted frame", f"{mean['predicted_kilobytes']:.1f} KB"),
        ("rendering, everything included", f"{mean['render_fps']:.0f} frames/s"),
        ("first picture after", f"{first_picture:.0f} s"),
        ("whole demo", f"{total:.0f} s"),
        *((f"last frame, {name}", f"{seconds:.2f} s") for name, seconds in stages.items()),
    ]
    table = "\n".join(f"| {name} | {value} |" for name, value in rows)
    return f"""# streamlod demo

{settings.cameras} synthetic cameras of {settings.size}, {settings.views} of them trained live, cam00 held out.

| | |
| --- | --- |
{table}

- `orbit.mp4`: what a websocket client saw from a moving viewpoint while the scene trained
- `held-out/`: the held-out camera, truth beside rendering
- `{scene.name}`: the recording; try `streamlod info {scene}`
"""


def _step(what: str, *arguments: object) -> None:
    _LOG.info("%s", what)
    result = subprocess.run([*_STREAMLOD, *map(str, arguments)], check=False)
    if result.returncode:
        raise InputError(f"demo, {what}", f"`streamlod {' '.join(map(str, arguments))}` failed; its message is above")


@contextmanager
def _server(settings: DemoSettings, clip: Path) -> Iterator[str]:
    """A running `streamlod serve` over the clip; yields its address and stops it in the end."""
    log = (settings.out / "server.log").open("w")
    place = f"--views {settings.views} --test cam00 --host {settings.host} --port {settings.port}"
    command = [*_STREAMLOD, "serve", "--data", str(clip), *place.split(), "--state-dir", str(settings.out / "state")]
    _LOG.info("starting the server")
    process = subprocess.Popen(command, stderr=log, stdout=log)
    base = f"http://{settings.host}:{settings.port}"
    try:
        limit = time.monotonic() + _START_SECONDS
        while not _answers(f"{base}/healthz"):
            if process.poll() is not None:
                last = (settings.out / "server.log").read_text().strip().splitlines()[-1:]
                raise InputError("demo", f"the server did not start: {' '.join(last) or 'see server.log'}")
            if time.monotonic() > limit:
                raise InputError("demo", f"the server did not answer within {_START_SECONDS:.0f} s; see server.log")
            time.sleep(_POLL_SECONDS)
        yield base
    finally:
        process.terminate()
        try:
            process.wait(15)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        log.close()


def _answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=2):
            return True
    except OSError:
        return False


def _get(url: str) -> Any:
    with urllib.request.urlopen(url, timeout=10) as answer:
        return json.load(answer)


def _wait(base: str, what: str, done: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Poll the stream until `done(stream)`; its progress is logged."""
    limit, told = time.monotonic() + _TRAIN_SECONDS, ""
    while time.monotonic() < limit:
        stream: dict[str, Any] = _get(f"{base}/v1/streams/main")
        if stream["state"] == "failed":
            raise InputError("demo", f"training failed: {stream['detail']}")
        if done(stream):
            return stream
        progress = stream.get("progress") or {}
        text = (
            f"waiting for {what}: {stream['state']}, {100 * (progress.get('fraction') or 0):.0f} % of the first frame"
        )
        if stream["version"] is not None:
            text = f"waiting for {what}: frame {stream['version']}"
        if text != told:
            _LOG.info(text)
            told = text
        time.sleep(_POLL_SECONDS)
    raise InputError("demo", f"gave up waiting for {what} after {_TRAIN_SECONDS:.0f} s")


def _download(url: str, path: Path) -> None:
    with urllib.request.urlopen(url, timeout=60) as answer:
        write_bytes(path, answer.read())


def _sleep_until_interrupted() -> None:
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        pass
