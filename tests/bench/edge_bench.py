"""Edges: what they take from the origin, what a hop costs, and how soon there is a picture.

    streamlod bench edge [--viewers 100 --seconds 10 --repeats 10 --short]

Starts an origin that plays a synthetic recording, an edge before it and an edge before that, each a process, as they
are started from the command line. Viewers of the traffic and delay rounds decode nothing; the first picture is that of
the Python client. The clocks compared are one clock: everything runs on one machine.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from streamlod.client.connection.link import WatchOptions
from streamlod.client.connection.watch import watch
from streamlod.client.events import NewScene
from tests.bench.fanout_viewers import watch as watch_many
from tests.server.conftest import make_clip
from tests.server.edge.processes import Node, node
from tests.waiting import wait

_COUNTS = (100, 400, 1500)  # anchors by level
VIEWER_CORE = 1


def chain(stack: ExitStack, folder: Path, clip: Path, hops: int) -> list[Node]:
    """An origin with a state folder, and edges one behind the other."""
    nodes = [stack.enter_context(node(folder, "serve", "--play", clip, "--state-dir", folder / "state"))]
    wait(lambda: nodes[0].stream()["state"] == "live")
    for _ in range(hops):
        nodes.append(stack.enter_context(node(folder, "edge", "--origin", nodes[-1].url)))
        wait(lambda: nodes[-1].get("/v1/streams/main").status_code == 200)
    return nodes


@contextmanager
def crowd(port: int, viewers: int, core: int = VIEWER_CORE) -> Iterator[Connection]:
    """A process of so many viewers on a core, which decode nothing."""
    context = multiprocessing.get_context("spawn")
    pipe, theirs = context.Pipe()
    process = context.Process(target=watch_many, args=(theirs, core, port), daemon=True)
    process.start()
    try:
        add(pipe, viewers)
        yield pipe
    finally:
        pipe.send(None)
        process.join(10)
        process.kill()


def add(pipe: Connection, viewers: int) -> None:
    """Let so many more join."""
    pipe.send((viewers, 0))
    pipe.recv()


def collect(pipe: Connection) -> tuple[dict[int, int], int]:
    """First arrival [monotonic ns] by version, and bytes received since the crowd's begin."""
    pipe.send("collect")
    arrivals, received, _ = pipe.recv()
    return dict(reversed(arrivals)), received


def sent_bytes(server: Node) -> float:
    """Bytes of packets that a server has sent to viewers, edges among them."""
    lines = server.get("/metrics").text.splitlines()
    return float(
        next(line.split()[1] for line in lines if line.startswith('streamlod_sent_bytes_total{stream="main"}'))
    )


def traffic(nodes: list[Node], viewers: int, seconds: float) -> dict[str, float]:
    """Bytes that leave the origin against bytes that reach the viewers of the last edge."""
    with crowd(nodes[-1].port, viewers) as pipe:
        time.sleep(2.0)
        before, (_, reached_before) = sent_bytes(nodes[0]), collect(pipe)
        time.sleep(seconds)
        after, (_, reached_after) = sent_bytes(nodes[0]), collect(pipe)
    origin, reached = after - before, reached_after - reached_before
    return {"viewers": viewers, "origin_bytes": origin, "viewer_bytes": reached, "ratio": reached / origin}


def hop_delay(nodes: list[Node], seconds: float) -> dict[str, list[float]]:
    """Delay behind each edge [ms]: p50 and p99 of the same packets' arrival there and directly from the origin."""
    with ExitStack() as stack:
        pipes = [stack.enter_context(crowd(each.port, 1)) for each in nodes]
        time.sleep(1.0)
        for pipe in pipes:
            collect(pipe)
        time.sleep(seconds)
        arrivals = [collect(pipe)[0] for pipe in pipes]
    found = {}
    for hops, those in enumerate(arrivals[1:], 1):
        delays = np.array([(those[version] - at) / 1e6 for version, at in arrivals[0].items() if version in those])
        if not len(delays):
            raise SystemExit(
                f"no packet arrived both at the origin and behind {hops} edges: measure for more --seconds"
            )
        found[f"{hops} hops"] = [float(value) for value in np.percentile(delays, (50, 99))] + [len(delays)]
    return found


async def first_picture(server: Node) -> float:
    """Seconds from connecting to the first decoded scene."""
    begin = time.monotonic()
    async for event in watch(f"ws://127.0.0.1:{server.port}/v1/streams/main/live", WatchOptions()):
        if isinstance(event, NewScene):
            break
    return time.monotonic() - begin


def main() -> None:
    """Run all rounds and print a line each."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--viewers", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--short", action="store_true", help="30 viewers, 5 seconds, four first pictures")
    options = parser.parse_args()
    if options.short:
        options.viewers, options.seconds, options.repeats = 30, 5.0, 4
    found: dict[str, Any] = {}

    def note(name: str, value: Any) -> None:
        found[name] = value
        print(f"{name}: {value}", flush=True)

    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        clip = make_clip(folder / "clip.slod", 1000, _COUNTS, key_every=100).path
        nodes = chain(stack, folder, clip, 2)
        note("first picture, cold edge [s]", asyncio.run(first_picture(nodes[1])))
        for where, server in (("origin", nodes[0]), ("warm edge", nodes[1])):
            times = [asyncio.run(first_picture(server)) for _ in range(options.repeats)]
            note(f"first picture, {where} [s], median and worst", [float(np.median(times)), max(times)])
        note("delay behind each edge [ms]: p50, p99, packets", hop_delay(nodes, options.seconds))
        note("traffic", traffic(nodes, options.viewers, options.seconds))
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
