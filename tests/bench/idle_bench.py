"""What a server takes that does not train: memory and processor time, without streams and with one that plays.

    python -m tests.bench.idle_bench [--seconds 10 --viewers 10]

Memory is resident, and in brackets what of it belongs to this process alone (the rest are pages of libraries' files,
which processes share and the system can drop). The processor's share is of one core, of the serving process.
"""

from __future__ import annotations

import argparse
import re
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

from tests.bench.abuse_bench import Honest, drain, measure
from tests.e2e.test_server_process import serving, wait_live
from tests.server.conftest import make_clip

_SETTLE_SECONDS = 5.0


def memory(pid: int) -> str:
    """Resident megabytes of a process, and those that are its own."""
    found = Path(f"/proc/{pid}/smaps_rollup").read_text()
    own = sum(int(size) for size in re.findall(r"^Private_\w+:\s+(\d+)", found, re.MULTILINE)[1:2])
    return f"{measure(pid)[0]:.0f} MB (own {own / 1000:.0f})"


def report(name: str, pid: int, seconds: float) -> None:
    """Print a line after so long."""
    time.sleep(_SETTLE_SECONDS)
    before = measure(pid)[2]
    time.sleep(seconds)
    share = (measure(pid)[2] - before) / seconds
    print(f"{name:40s} {memory(pid):24s} {100 * share:5.1f} % of a core", flush=True)


def main() -> None:
    """Three servers, one after the other."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--viewers", type=int, default=10)
    options = parser.parse_args()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        process, _ = stack.enter_context(serving())
        threading.Thread(target=drain, args=(process.stderr,), daemon=True).start()
        report("no stream", process.pid, options.seconds)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        clip = make_clip(folder / "scene.slod", 60, (50, 500, 4000), key_every=30)
        process, port = stack.enter_context(serving("--play", clip.path))
        threading.Thread(target=drain, args=(process.stderr,), daemon=True).start()
        wait_live(port)
        report("a stream of 4,550 anchors, 50 frames/s", process.pid, options.seconds)
        for _ in range(options.viewers):
            Honest(port).start()
        report(f"the same with {options.viewers} viewers", process.pid, options.seconds)


if __name__ == "__main__":
    main()
