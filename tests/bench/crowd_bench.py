"""Viewers an edge: how many get every packet of a stream soon, and what each costs.

    streamlod bench crowd [--kbps 1000 --edges 1 --viewers 100,200,400 --seconds 10 --settle 3
        --json FILE --short]

Starts an origin that plays a synthetic recording of so many kbit/s, edges before it, and processes of viewers that
decode nothing. A single edge has a core of its own, and the viewers another; several edges share the cores with the
viewers. Printed for each number of viewers, over all edges: the share of packets that reached them, how much later than
at a viewer of the origin (p50, p90 and p99, of ten viewers of each edge that look all the time), the edges' CPU time as
a share of one core, the bytes that they sent for each second of it, CPU time of a join, and the bytes from the origin
against those to viewers. A number is held where 99 % of the packets arrive, 99 % of these within 250 ms;
the first that is not is the last. Viewers that join all at once leave the edges behind for a while, for which it waits
(`--settle`).
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from tests.bench.bulk_viewers import watch
from tests.bench.edge_bench import VIEWER_CORE, crowd, sent_bytes
from tests.server.conftest import make_clip
from tests.server.edge.processes import Node, node
from tests.waiting import wait

_COUNTS = (200, 800, 3000)  # anchors by level
_FRAMES, _KEY_EVERY = 900, 300
_EDGE_CORE = 0
_MARGIN_SECONDS = 1.5  # at both ends: packets that came before, or have not come everywhere
_PROBES = 10  # viewers of each edge whose delays are measured
_HELD_SHARE, _HELD_MS = 0.99, 250.0
_LIMITS = "[limits]\nviewers = 20000\nviewers_per_address = 20000\nconnections = 40000\n"


def clip_of(path: Path, kbps: float) -> Path:
    """A recording with this rate: its frames are as far apart as that takes."""
    made = make_clip(path, 30, _COUNTS, key_every=10**6)
    frame_bytes = sum(map(len, made.packets[1:])) / 29 + len(made.packets[0]) / _KEY_EVERY
    frame_ns = int(frame_bytes * 8 / (kbps * 1000) * 1e9)
    return make_clip(path, _FRAMES, _COUNTS, key_every=_KEY_EVERY, frame_ns=frame_ns).path


def cpu_seconds(server: Node) -> float:
    """CPU time of a process so far, of user and kernel."""
    fields = Path(f"/proc/{server.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Crowd:
    """Viewers of several edges, and one of the origin, whose packets count as what there is."""

    def __init__(self, stack: ExitStack, origin: Node, edges: list[Node]) -> None:
        self.origin, self.edges = origin, edges
        self._direct = stack.enter_context(crowd(origin.port, 1))
        self._probes = [stack.enter_context(crowd(edge.port, _PROBES)) for edge in edges]
        self._pipes = [stack.enter_context(bulk(edge.port)) for edge in edges]
        self._viewers = [0] * len(edges)

    def grow(self, viewers: int) -> float:
        """Join until there are so many; CPU seconds of all edges for each that joined, with what they got meanwhile."""
        before, joined = sum(map(cpu_seconds, self.edges)), viewers - sum(self._viewers)
        for number, pipe in enumerate(self._pipes):
            wanted = viewers // len(self.edges) + (number < viewers % len(self.edges))
            pipe.send(wanted - self._viewers[number])
            self._viewers[number] = wanted
        for pipe in self._pipes:
            pipe.recv()
        return (sum(map(cpu_seconds, self.edges)) - before) / joined

    def measure(self, seconds: float) -> dict[str, float]:
        """What the viewers get, for so long."""
        own, received = _collect(self._direct)[1], -sum(_collect(pipe)[1] for pipe in self._pipes)
        received -= sum(_collect(pipe)[1] for pipe in self._probes)
        origin, cpu, begun = sent_bytes(self.origin), sum(map(cpu_seconds, self.edges)), time.monotonic()
        time.sleep(seconds)
        cpu, took = sum(map(cpu_seconds, self.edges)) - cpu, time.monotonic() - begun
        origin = sent_bytes(self.origin) - origin
        direct, own_now, _ = _collect(self._direct)
        origin -= own_now - own  # that viewer's part
        times = [at for _, at in direct]
        first, last = min(times) + _MARGIN_SECONDS * 1e9, max(times) - _MARGIN_SECONDS * 1e9
        inside = [(version, at) for version, at in direct if first < at < last]
        published = dict(reversed(inside))
        delays: list[float] = []
        for pipe in self._probes:
            arrived, total, _ = _collect(pipe)
            delays += [(at - published[version]) / 1e6 for version, at in arrived if version in published]
            received += total
        packets, lost = 0, 0
        for pipe in self._pipes:
            counts, total, gone = _collect(pipe)
            packets += sum(counts[version] for version in published)
            received, lost = received + total, lost + gone
        everybody = sum(self._viewers) + _PROBES * len(self.edges)
        p50, p90, p99 = np.percentile(delays or [np.inf], (50, 90, 99))
        return {
            "viewers": everybody,
            "lost": lost,
            "share": packets / (len(inside) * sum(self._viewers)),
            "probes_share": len(delays) / (len(inside) * _PROBES * len(self.edges)),
            "p50_ms": float(p50),
            "p90_ms": float(p90),
            "p99_ms": float(p99),
            "cores": cpu / took,
            "bytes_per_cpu_second": received / cpu,
            "viewer_kbps": received / everybody / took * 8 / 1000,
            "origin_bytes": origin,
            "viewer_bytes": received,
        }


@contextmanager
def bulk(port: int) -> Iterator[Connection]:
    """An empty process of viewers that look a few times a second."""
    context = multiprocessing.get_context("spawn")
    pipe, theirs = context.Pipe()
    process = context.Process(target=watch, args=(theirs, VIEWER_CORE, port), daemon=True)
    process.start()
    try:
        yield pipe
    finally:
        pipe.send(None)
        process.join(10)
        process.kill()


def _collect(pipe: Connection) -> Any:
    pipe.send("collect")
    return pipe.recv()


def main() -> None:
    """Run all numbers of viewers and print a line each."""
    parser = argparse.ArgumentParser(prog="streamlod bench crowd")
    parser.add_argument("--kbps", type=float, default=1000)
    parser.add_argument("--edges", type=int, default=1)
    parser.add_argument("--viewers", default="100,200,400,800,1600")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--settle", type=float, default=3.0, help="seconds between joining and measuring")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--short", action="store_true", help="50 and 100 viewers, 5 seconds")
    options = parser.parse_args()
    if options.short:
        options.viewers, options.seconds = "50,100", 5.0
    found: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        config = folder / "limits.toml"
        config.write_text(_LIMITS)
        clip = clip_of(folder / "clip.slod", options.kbps)
        origin = stack.enter_context(node(folder, "serve", "--play", clip, "--config", config))
        wait(lambda: origin.stream()["state"] == "live")
        edges = []
        for _ in range(options.edges):
            edge = stack.enter_context(node(folder, "edge", "--origin", origin.url, "--config", config))
            if options.edges == 1:
                os.sched_setaffinity(edge.process.pid, {_EDGE_CORE})
            wait(lambda edge=edge: edge.get("/v1/streams/main").status_code == 200)
            edges.append(edge)
        viewers = Crowd(stack, origin, edges)
        for count in map(int, options.viewers.split(",")):
            join = viewers.grow(count)
            time.sleep(options.settle)
            one = viewers.measure(options.seconds) | {"join_cpu_seconds": join}
            one["held"] = min(one["share"], one["probes_share"]) >= _HELD_SHARE and one["p99_ms"] <= _HELD_MS
            found.append(one)
            print(
                f"{one['viewers']:.0f} viewers: {one['share']:.1%} of the packets, p50 {one['p50_ms']:.0f} ms, "
                f"p90 {one['p90_ms']:.0f} ms, p99 {one['p99_ms']:.0f} ms later, {one['viewer_kbps']:.0f} kbit/s each, "
                f"{one['cores']:.0%} of a core, {one['bytes_per_cpu_second'] / 1e6:.0f} MB per CPU-second, "
                f"a join {1000 * join:.1f} ms, bytes 1 : {one['viewer_bytes'] / one['origin_bytes']:.0f}, "
                f"{one['lost']:.0f} lost, {'held' if one['held'] else 'NOT held'}",
                flush=True,
            )
            if not one["held"]:
                break
    if options.json:
        options.json.write_text(
            json.dumps({"kbps": options.kbps, "edges": options.edges, "rows": found}, indent=1) + "\n"
        )


if __name__ == "__main__":
    main()
