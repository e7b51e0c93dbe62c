"""Fan-out: our server against a plain asyncio broadcast of the same bytes, one core each, viewers on another core.

    streamlod bench fanout [--viewers 500 --kilobytes 100 --rate 10 --stuck 20 --short]

Prints: MB given to sockets per CPU-second of the server, as fast as it goes; the time from publishing to the last byte
in the viewer's process at a steady rate; and what viewers that take nothing do to the others. Acknowledgements are
sent as docs/protocol.md asks. Two idle cores are wanted; the viewers' process costs about as much as a server.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from statistics import median
from typing import Any

import numpy as np

from tests.bench.fanout_load import Run
from tests.bench.fanout_servers import serve_hub, serve_plain
from tests.bench.fanout_viewers import watch

_SERVER_CORE, _VIEWER_CORE = 0, 1
_ROUNDS = 8  # of which the median counts; single ones differ by a third
_ROUND_SECONDS = 1.0
_STUCK_SECONDS = 38.0  # the default limit and some more


class Bench:
    """A server and a process of viewers."""

    def __init__(self, server: Connection, viewers: Connection) -> None:
        self._server, self._viewers = server, viewers

    def join(self, viewers: int, stuck: int = 0) -> None:
        """Connect more viewers."""
        self._viewers.send((viewers, stuck))
        self._viewers.recv()
        time.sleep(1.0)
        self._collect()

    def run(self, rate: float, seconds: float) -> tuple[Run, np.ndarray[Any, Any], list[str]]:
        """Publish; what the server saw, delays [ms] of all packets that arrived, reasons of viewers closed."""
        self._server.send((rate, seconds))
        found: Run = self._server.recv()
        time.sleep(0.5)
        arrivals, _, reasons = self._collect()
        delays = [(at - found.published_ns[v]) / 1e6 for v, at in arrivals if v in found.published_ns]
        return found, np.array(delays), reasons

    def _collect(self) -> Any:
        self._viewers.send("collect")
        return self._viewers.recv()


@contextmanager
def benching(serve: Callable[..., None], packets: int, size_bytes: int) -> Iterator[Bench]:
    """A server that has made its packets, and an empty process of viewers."""
    context = multiprocessing.get_context("spawn")
    server_end, server_pipe = context.Pipe()
    viewer_end, viewer_pipe = context.Pipe()
    server = context.Process(target=serve, args=(server_pipe, _SERVER_CORE, packets, size_bytes), daemon=True)
    server.start()
    viewers = context.Process(target=watch, args=(viewer_pipe, _VIEWER_CORE, server_end.recv()), daemon=True)
    viewers.start()
    try:
        yield Bench(server_end, viewer_end)
    finally:
        for end, process in ((viewer_end, viewers), (server_end, server)):
            end.send(None)
            process.join(15)
            process.kill()


def saturate(viewers: int, size_bytes: int) -> list[float]:
    """MB per CPU-second of ours over those of the plain broadcast, as fast as it goes, in turns beside each other."""
    ratios, packets = [], int(_ROUNDS * _ROUND_SECONDS * 100)
    with benching(serve_plain, packets, size_bytes) as plain, benching(serve_hub, packets, size_bytes) as ours:
        for bench in (plain, ours):
            bench.join(viewers)
            bench.run(0, _ROUND_SECONDS / 2)
        for _ in range(_ROUNDS):
            found = [bench.run(0, _ROUND_SECONDS)[0] for bench in (plain, ours)]
            rates = [run.sent_bytes / 1e6 / run.cpu_seconds for run in found]
            ratios.append(rates[1] / rates[0])
            print(f"{viewers} viewers, as fast as it goes: plain {rates[0]:.0f} MB per CPU-second, ours {rates[1]:.0f}")
    return ratios


def describe(name: str, run: Run, delays: np.ndarray[Any, Any], expected: int) -> float:
    """Print one steady run; its 99th percentile [ms]."""
    p50, p99 = np.percentile(delays, [50, 99])
    print(
        f"{name:28} p50 {p50:5.1f} ms  p99 {p99:5.1f} ms  longest {delays.max():5.0f} ms  "
        f"{run.cpu_seconds / run.wall_seconds:4.0%} of a core  {len(delays)} of {expected} packets"
    )
    return float(p99)


def main() -> None:
    """Run all parts."""
    parser = argparse.ArgumentParser(prog="streamlod bench fanout")
    parser.add_argument("--viewers", type=int, default=500)
    parser.add_argument("--kilobytes", type=float, default=100)
    parser.add_argument("--rate", type=float, default=10)
    parser.add_argument("--stuck", type=int, default=20)
    parser.add_argument("--short", action="store_true", help="leave out the 30 s that stuck viewers are given")
    options = parser.parse_args()
    size, rate, count = int(options.kilobytes * 1000), options.rate, options.viewers
    ratios = saturate(count, size)
    print(f"ours / plain: median {median(ratios):.2f}, {min(ratios):.2f} to {max(ratios):.2f}")

    with benching(serve_plain, 200, size) as bench:
        bench.join(count)
        run, delays, _ = bench.run(rate, 5)
        describe(f"plain, {count} viewers", run, delays, len(run.published_ns) * count)
    with benching(serve_hub, 800, size) as bench:
        bench.join(count - options.stuck)
        bench.run(rate, 5)
        run, delays, _ = bench.run(rate, 8)
        expected = len(run.published_ns) * (count - options.stuck)
        alone = describe(f"ours, {count - options.stuck} viewers", run, delays, expected)
        before = run
        bench.join(0, options.stuck)
        run, delays, _ = bench.run(rate, 8)
        expected = len(run.published_ns) * (count - options.stuck)
        beside = describe(f"ours, and {options.stuck} stuck", run, delays, expected)
        resident = (run.resident_bytes - before.resident_bytes) / options.stuck / 1024
        kernel = (run.kernel_bytes - before.kernel_bytes) / options.stuck / 1024
        print(f"p99 beside stuck viewers / alone: {beside / alone:.2f}")
        print(f"a stuck viewer costs {resident:.0f} KiB of the process, {kernel:.0f} KiB of its socket's buffers")
        if not options.short:
            run, _, reasons = bench.run(rate, _STUCK_SECONDS - 8)
            print(f"stuck viewers cut off: {run.cut_off} of {options.stuck}; other viewers closed: {len(reasons)}")
            print("\n".join(sorted(set(run.faults))))


if __name__ == "__main__":
    main()
