"""Start-up and fan-out of this version against an earlier one, in turns beside each other, as ratios.

    streamlod bench versions [--before COMMIT --rounds 5 --viewers 50 --seconds 8]

Both versions are taken from git's history: the last commit, and by default the last one before edges, NATS and Ray.
Each serves a clip of 50 frames a second from a file to as many viewers. Compared is processor time, which other work on
the machine changes less than the clock: of the serving process until it listens, and for each MB that viewers get from
it. Both load their kernels and serve once before anything is measured.
"""

from __future__ import annotations

import argparse
import io
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
import time
import zipfile
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from tests.bench.fanout_viewers import watch
from tests.bench.idle_bench import cpu_seconds

ROOT = Path(__file__).parents[2]
BEFORE_THE_CLUSTER = "3f14add"
_VIEWER_CORE = 1
_SETTLE_SECONDS = 6.0  # for kernels to be loaded and all viewers to join
_PREPARE = """
from streamlod.server.pipeline.warming import warm_codec
from tests.server.conftest import make_clip, Path
warm_codec()
make_clip(Path({!r}), 150, (50, 200, 800), key_every=50)
"""


@dataclass(frozen=True, slots=True)
class Taken:
    """What a version took.

    Attributes:
        start_cpu, start_wall: seconds from the start of the process until it listens.
        cpu_per_mb: seconds of processor time for each MB that viewers got.
    """

    start_cpu: float
    start_wall: float
    cpu_per_mb: float


def extracted(commit: str, folder: Path) -> Path:
    """The code of a commit.

    Raises:
        subprocess.CalledProcessError: git does not know it.
    """
    parts = ("core", "codec", "server", "client", "tests")
    command = ["git", "-C", ROOT, "archive", "--format=zip", commit, *parts]
    archive = subprocess.run(command, capture_output=True, check=True).stdout
    with zipfile.ZipFile(io.BytesIO(archive)) as packed:
        packed.extractall(folder)
    return folder


def of(source: Path) -> dict[str, str]:
    """The environment of a process that runs the code of that folder."""
    return os.environ | {"PYTHONPATH": str(source)}


def run(source: Path, program: str) -> str:
    """What a program prints that imports the code of that folder."""
    command = [sys.executable, "-c", program]
    return subprocess.run(command, cwd=source, env=of(source), stdout=subprocess.PIPE, text=True, check=True).stdout


def measured(source: Path, clip: Path, viewers: int, seconds: float) -> Taken:
    """Start a server of that version, let viewers watch, and stop it."""
    command = [sys.executable, "-m", "streamlod.server.cli", "serve", "--port", "0", "--play", str(clip)]
    log, begin = clip.with_suffix(".log"), time.monotonic()
    with log.open("w") as file, subprocess.Popen(command, cwd=source, env=of(source), stderr=file) as process:
        try:
            while (found := re.search(r"http://127\.0\.0\.1:(\d+)", log.read_text())) is None:
                assert process.poll() is None, log.read_text()
                time.sleep(0.01)
            start = cpu_seconds(process.pid), time.monotonic() - begin
            return Taken(*start, _cpu_per_mb(process.pid, int(found[1]), viewers, seconds))
        finally:
            process.kill()


def _cpu_per_mb(pid: int, port: int, viewers: int, seconds: float) -> float:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=watch, args=(theirs, _VIEWER_CORE, port), daemon=True)
    process.start()
    ours.send((viewers, 0))
    ours.recv()
    time.sleep(_SETTLE_SECONDS)
    ours.send("collect")
    bytes_before, cpu_before = ours.recv()[1], cpu_seconds(pid)
    time.sleep(seconds)
    ours.send("collect")
    received, cpu = ours.recv()[1] - bytes_before, cpu_seconds(pid) - cpu_before
    ours.send(None)
    process.join()
    return cpu / (received / 1e6)


def report(name: str, before: list[float], now: list[float], unit: str) -> None:
    """A line: both medians, and the ratio of each round's pair."""
    ratios = [b / a for a, b in zip(before, now, strict=True)]
    spread = f"{min(ratios):.2f} to {max(ratios):.2f}"
    print(f"{name:44s} {median(before):8.3f} {median(now):8.3f} {unit:8s} {median(ratios):5.2f} ({spread})", flush=True)


def main() -> None:
    """Both versions in turns."""
    parser = argparse.ArgumentParser(prog="streamlod bench versions")
    parser.add_argument("--before", default=BEFORE_THE_CLUSTER, metavar="COMMIT")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--viewers", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=8.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            sources = extracted(options.before, folder / "before"), extracted("HEAD", folder / "now")
        except subprocess.CalledProcessError as error:
            parser.error(f"git: {error.stderr.decode().strip()}")
        clips = [source.with_suffix(".slod") for source in sources]
        for source, clip in zip(sources, clips, strict=True):
            run(source, _PREPARE.format(str(clip)))
        rounds = [
            [
                measured(source, clip, options.viewers, options.seconds)
                for source, clip in zip(sources, clips, strict=True)
            ]
            for _ in range(options.rounds + 1)
        ][1:]
    before, now = ([pair[number] for pair in rounds] for number in (0, 1))
    print(f"{'median of ' + str(options.rounds):44s} {'before':>8s} {'now':>8s} {'':8s} {'now / before':>5s}")
    report("start, processor time", [t.start_cpu for t in before], [t.start_cpu for t in now], "s")
    report("start, clock", [t.start_wall for t in before], [t.start_wall for t in now], "s")
    cost = [[1000 * t.cpu_per_mb for t in each] for each in (before, now)]
    report(f"fan-out to {options.viewers} viewers, processor time", *cost, "ms / MB")


if __name__ == "__main__":
    main()
