"""How long a stream stands still when its worker is killed: a real server, one viewer, kill -9 in mid-frame.

    python -m tests.bench.restart_bench [--kills 3 --pause 20 --no-spare]

Prints, for a recorded file and for a stream in training: seconds from the kill to the event that tells of it, to the
first whole picture of the new epoch in the viewer's decoder, and to the next version that was trained after it; and
what the processes take, the worker first. Between kills the next spare process gets ready. An idle machine is wanted.
"""

from __future__ import annotations

import argparse
import os
import signal
import tempfile
import time
from pathlib import Path

from tests.e2e.test_server_process import family, live, serving
from tests.server.conftest import Viewer, make_clip

_TRAINING = """
[[streams]]
id = "main"
synthetic = {{cameras = 4, frames = 100000, width = {0}, height = {1}}}
"""
_MAX_SECONDS = 300.0


def resident_bytes(pid: int) -> int:
    """Resident memory of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def watch(name: str, arguments: list[object], kills: int, pause_seconds: float) -> None:
    """Kill the largest of the server's processes again and again, and print what its viewer saw."""
    with serving(*arguments) as (server, port), live(port) as connection:
        viewer = Viewer(connection).hello()
        viewer.until("caught_up", _MAX_SECONDS)
        for number in range(kills):
            at, ready = max(viewer.decoder.versions) + 5, time.monotonic() + pause_seconds
            while time.monotonic() < ready or not at <= min(viewer.decoder.versions) == max(viewer.decoder.versions):
                viewer.step(_MAX_SECONDS)
            workers = sorted(family(server.pid)[1:], key=resident_bytes)
            sizes = ", ".join(f"{resident_bytes(pid) / 1e6:.0f}" for pid in [server.pid, *reversed(workers)])
            begin = time.monotonic()
            os.kill(workers[-1], signal.SIGKILL)
            viewer.until("state", _MAX_SECONDS)
            told = time.monotonic() - begin
            viewer.until("epoch", _MAX_SECONDS)
            viewer.next_packet()
            while len(set(viewer.decoder.versions)) > 1:
                viewer.step(_MAX_SECONDS)
            shown, version = time.monotonic() - begin, viewer.decoder.versions[0]
            while min(viewer.decoder.versions) == version:
                viewer.step(_MAX_SECONDS)
            going = time.monotonic() - begin
            print(f"{name} {number + 1}: told after {told:.2f} s, a picture after {shown:.2f} s, the next version "
                  f"after {going:.2f} s; server and its processes {sizes} MB")  # fmt: skip


def main() -> None:
    """Both kinds of stream."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--kills", type=int, default=3)
    parser.add_argument("--pause", type=float, default=20.0)
    parser.add_argument("--no-spare", action="store_true")
    parser.add_argument("--width", type=int, default=160)
    parser.add_argument("--height", type=int, default=90)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        clip = make_clip(folder / "scene.slod", 60, counts=(50, 500, 4000), key_every=30)
        watch("recorded file", ["--play", clip.path], options.kills, 0.0)
        config = folder / "server.toml"
        spare = "[worker]\nspare = false\n" if options.no_spare else ""
        config.write_text(spare + _TRAINING.format(options.width, options.height))
        watch("in training", ["--config", config], options.kills, options.pause)


if __name__ == "__main__":
    main()
