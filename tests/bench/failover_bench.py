"""Faults of edges and origin, each several times: how long the picture stands still at a viewer of the Python client.

    streamlod bench failover [--repeats 10 --faults none,stop,kill,alone,origin --json FILE --short]

none: nothing happens, for comparison. stop: the viewer's edge gets SIGTERM, another one is there. kill: it gets
SIGKILL, another one is there. alone: it gets SIGKILL and there is no other; it is started again at once, as a service
manager does. origin: the origin gets SIGKILL and is started again at once, with its state folder. What is told is the
longest time from one picture to the next, of 50 a second, as a list over the repeats; for `alone` and `origin` also
what of it comes after the process listens again.
"""

from __future__ import annotations

import argparse
import json
import signal
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from tests.bench.pictures import longest_gap
from tests.server.conftest import make_clip
from tests.server.edge.processes import Node, begin, listening
from tests.server.ports import free_ports
from tests.waiting import wait

_COUNTS = (100, 400, 1500)  # anchors by level
_FAULTS = ("none", "stop", "kill", "alone", "origin")


class Cluster:
    """An origin and two edges that it knows, or one that it does not; each can be started again on its port."""

    def __init__(self, folder: Path, clip: Path, edges: int) -> None:
        self._folder = folder
        ports = free_ports(1 + edges)
        config = folder / "origin.toml"
        known = [f"http://127.0.0.1:{port}" for port in ports[1:]] if edges > 1 else []
        config.write_text(f"edges = {json.dumps(known)}\n")
        origin = ("serve", "--play", clip, "--state-dir", folder / "state", "--config", config)
        self._commands = [origin] + [("edge", "--origin", f"http://127.0.0.1:{ports[0]}")] * edges
        self.nodes: list[Node] = []
        self.start_seconds: list[float] = []  # from each kill until the process listens again
        for number, port in enumerate(ports):
            self.nodes.append(self._start(number, port))
        for edge in self.nodes[1:]:
            wait(lambda edge=edge: edge.get("/v1/server").json()["edges"] == known)

    def stop(self, number: int) -> None:
        """SIGTERM, until it has ended."""
        self.nodes[number].process.send_signal(signal.SIGTERM)
        self.nodes[number].process.wait(20)

    def start(self, number: int) -> None:
        """Start a node again."""
        self.nodes[number] = self._start(number, self.nodes[number].port)

    def kill_and_start(self, number: int) -> None:
        """SIGKILL, and start it again."""
        begun = time.monotonic()
        self.nodes[number].kill()
        started = listening(begin(self._folder, *self._commands[number], port=self.nodes[number].port))
        self.start_seconds.append(time.monotonic() - begun)
        self.nodes[number] = ready(started)

    def close(self) -> None:
        for each in self.nodes:
            each.kill()

    def _start(self, number: int, port: int) -> Node:
        return ready(listening(begin(self._folder, *self._commands[number], port=port)))


def ready(started: Node) -> Node:
    """The process once viewers may come."""
    wait(lambda: started.get("/readyz").status_code == 200)
    return started


def once(cluster: Cluster, fault: str) -> float:
    """Inject a fault, mend it, and tell the longest time without a picture [s]."""
    port = cluster.nodes[1].port
    if fault == "none":
        return longest_gap(port, lambda: time.sleep(1))
    if fault == "origin":
        return longest_gap(port, lambda: cluster.kill_and_start(0))
    if fault == "alone":
        return longest_gap(port, lambda: cluster.kill_and_start(1))
    gap = longest_gap(port, lambda: cluster.stop(1) if fault == "stop" else cluster.nodes[1].kill())
    cluster.start(1)
    return gap


def tell(name: str, gaps: list[float]) -> None:
    """Print a line."""
    print(f"{name}: median {np.median(gaps):.2f} s, worst {max(gaps):.2f} s of {gaps}", flush=True)


def main() -> None:
    """Inject all faults and print a line each."""
    parser = argparse.ArgumentParser(prog="streamlod bench failover")
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--faults", default=",".join(_FAULTS))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--short", action="store_true", help="each fault twice")
    options = parser.parse_args()
    faults, repeats = options.faults.split(","), 2 if options.short else options.repeats
    if unknown := set(faults) - set(_FAULTS):
        parser.error(f"no such fault: {', '.join(sorted(unknown))}; there are {', '.join(_FAULTS)}")
    found: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as name:
        clip = make_clip(Path(name) / "clip.slod", 1000, _COUNTS, key_every=100).path
        for edges, group in ((2, {"none", "stop", "kill"}), (1, {"alone", "origin"})):
            with ExitStack() as stack:
                chosen = [fault for fault in faults if fault in group]
                if not chosen:
                    continue
                folder = Path(name) / str(edges)
                folder.mkdir()
                cluster = Cluster(folder, clip, edges)
                stack.callback(cluster.close)
                for fault in chosen:
                    cluster.start_seconds.clear()
                    found[fault] = [round(once(cluster, fault), 2) for _ in range(repeats)]
                    tell(fault, found[fault])
                    if starts := cluster.start_seconds:
                        later = [round(gap - start, 2) for gap, start in zip(found[fault], starts, strict=True)]
                        found[f"{fault}, after it listens"] = later
                        tell(f"{fault}, after it listens", later)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
