"""What a server takes that does not train: memory and processor time, without streams and with one that plays.

    python -m tests.bench.idle_bench [--seconds 10 --viewers 10]

Memory is resident, and in brackets what of it belongs to this process alone (the rest are pages of libraries' files,
which processes share and the system can drop). The processor's share is of one core, of the serving process. Once its
kernels are loaded the server gives the pages of LLVM back, which the system takes only where no other process has them
mapped: the last line says how many had. This process itself loads neither Numba nor the codec.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.bench.fanout_viewers import watch

_SETTLE_SECONDS = 5.0
_CLIP = "from tests.server.conftest import make_clip, Path; make_clip(Path({!r}), 60, (50, 500, 4000), key_every=30)"


@contextmanager
def serving(log: Path, *arguments: object) -> Iterator[tuple[int, int]]:
    """Process id and port of a `streamlod serve`."""
    command = [sys.executable, "-m", "streamlod.server.cli", "serve", "--port", "0", *map(str, arguments)]
    with log.open("w") as file, subprocess.Popen(command, stderr=file) as process:
        try:
            limit = time.monotonic() + 60
            while not (found := re.search(r"http://127\.0\.0\.1:(\d+)", log.read_text())):
                assert time.monotonic() < limit
                time.sleep(0.1)
            yield process.pid, int(found[1])
        finally:
            process.terminate()


def megabytes(pid: int) -> tuple[float, float]:
    """Resident memory of a process, and what of it is its own."""
    found = Path(f"/proc/{pid}/smaps_rollup").read_text()
    resident, *own = (
        sum(int(size) for size in re.findall(rf"^{name}:\s+(\d+)", found, re.MULTILINE))
        for name in ("Rss", "Private_Clean", "Private_Dirty")
    )
    return resident * 1024 / 1e6, sum(own) * 1024 / 1e6


def cpu_seconds(pid: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def report(name: str, pid: int, seconds: float) -> None:
    """Print a line after so long."""
    time.sleep(_SETTLE_SECONDS)
    before = cpu_seconds(pid)
    time.sleep(seconds)
    share = (cpu_seconds(pid) - before) / seconds
    resident, own = megabytes(pid)
    print(f"{name:40s} {resident:4.0f} MB (own {own:4.0f}) {100 * share:5.1f} % of a core", flush=True)


def users_of_the_compiler(pid: int) -> int:
    """Other processes that have the same LLVM mapped, as far as they may be looked at."""
    found = re.search(r"\S+/libllvmlite\.so", Path(f"/proc/{pid}/maps").read_text())
    count = -1
    for maps in Path("/proc").glob("[0-9]*/maps"):
        try:
            count += found is not None and found[0] in maps.read_text()
        except OSError:
            continue
    return count


def main() -> None:
    """Two servers, one after the other."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--viewers", type=int, default=10)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        clip = folder / "scene.slod"
        subprocess.run([sys.executable, "-c", _CLIP.format(str(clip))], check=True)
        with serving(folder / "log") as (pid, _):
            report("no stream", pid, options.seconds)
            others = users_of_the_compiler(pid)
        with serving(folder / "log", "--play", clip) as (pid, port):
            report("a stream of 4,550 anchors, 50 frames/s", pid, options.seconds)
            ours, theirs = multiprocessing.get_context("spawn").Pipe()
            viewers = multiprocessing.get_context("spawn").Process(target=watch, args=(theirs, 0, port), daemon=True)
            viewers.start()
            ours.send((options.viewers, 0))
            ours.recv()
            report(f"the same with {options.viewers} viewers", pid, options.seconds)
            ours.send(None)
            viewers.join()
    print(f"other processes that had LLVM mapped: {others}")


if __name__ == "__main__":
    main()
