"""`python -m tests.bench.step_cost`: nodes, bytes and floating-point work of a training step in Warp, without a GPU.

One step of a frame of ordinary size is taken on the CPU, and what it does is counted: pixels of dirty tiles, pairs of
pixel and Gaussian that are blended (as though no pixel ended early), Gaussians, anchors. Bytes and operations of each
are counted by reading the kernels; every array is taken to be read once from memory and from caches afterwards. The
times are what such a device needs at best: the larger of bytes over bandwidth and operations over peak for each
kernel, and 1.3 us that are assumed for every node.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

import pytest
import warp as wp

from streamlod.core.train.engine.warp.step import TrainingStep
from tests.bench.step_subject import Sizes, make_step, told, work

NODE_SECONDS = 1.3e-6
SORT_PASSES_BITS = 8  # a pass of CUB's radix sort takes so many bits; a histogram and a scan come before
# Bytes a second and float32 operations a second, as the makers publish them.
DEVICES = {"H100": (3.35e12, 67e12), "RTX 4070": (504e9, 29e12), "RTX 4060 laptop": (256e9, 15e12)}


@dataclass(frozen=True)
class Cost:
    """The cost of one kernel in a step."""

    bytes: float
    operations: float


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", default="1280x720", help="of the pictures")
    for name in ("anchors", "moving", "cameras", "views"):
        parser.add_argument(f"--{name}", type=int, default=getattr(Sizes(), name))
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    sizes = Sizes(given.anchors, given.moving, Sizes().slots, width, height, given.cameras, given.views)
    step = make_step(sizes, "cpu")
    chosen = [number % sizes.cameras for number in range(sizes.views)]
    step.tell(0, told(0, width * height), chosen)
    step.launch()
    done, nodes = work(step.room), nodes_of(step)
    for name, count in done.items():
        print(f"{name}: {count:,}")
    costs = costs_of(sizes, done)
    print(f"nodes: {sum(nodes.values())} ({', '.join(f'{count} {name}' for name, count in nodes.items())})\n")
    print("| kernel | MB | Mflop |", *(f"{name}, us |" for name in DEVICES))
    print("| --- " * (3 + len(DEVICES)) + "|")
    for name, cost in costs.items():
        _row(name, cost, *(_best(cost, *speeds) for speeds in DEVICES.values()))
    total = Cost(sum(c.bytes for c in costs.values()), sum(c.operations for c in costs.values()))
    waiting = NODE_SECONDS * sum(nodes.values())
    _row("step", total, *(waiting + sum(_best(c, *s) for c in costs.values()) for s in DEVICES.values()))


def nodes_of(step: TrainingStep) -> dict[str, int]:
    """Nodes of a step's graph by kind, counted while it is launched."""
    found = {"kernels": 0, "fills": 0, "of the sort": 0}

    def counting(kind: str, function: Any, nodes: Any = lambda *_: 1) -> Any:
        def call(*arguments: Any, **named: Any) -> Any:
            found[kind] += nodes(*arguments)
            return function(*arguments, **named)

        return call

    def passes(_keys: Any, _values: Any, _count: int, first: int, end: int) -> int:
        return 2 + -(-(end - first) // SORT_PASSES_BITS)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wp, "launch", counting("kernels", wp.launch))
        patch.setattr(wp.utils, "radix_sort_pairs", counting("of the sort", wp.utils.radix_sort_pairs, passes))
        patch.setattr(wp.array, "zero_", counting("fills", wp.array.zero_))
        step.launch()
    return found


def costs_of(sizes: Sizes, done: dict[str, int]) -> dict[str, Cost]:
    """Bytes and operations of each kernel, the numbers a thread reads, writes and works out counted by reading it."""
    gaussians, anchors, views = done["moving Gaussians"], sizes.moving, sizes.views
    drawn, moving = views * gaussians, done["pairs of moving"]
    dirty, near = 256 * done["dirty tiles"], 256 * done["dirty tiles"] * 1.7  # and five pixels around
    pairs = moving + done["pairs of still in dirty tiles"]
    capacity = done["room for pairs of moving"]
    sort_passes = 2 + -(-(32 + done["tiles"].bit_length()) // SORT_PASSES_BITS)
    hidden = 32 * (2 * 12 + 2 * 4 + 2 * 11)
    return {
        "decode": Cost(anchors * 4 * 80 + gaussians * 4 * 17, gaussians * (hidden + 120)),
        "clear": Cost(8 * capacity, 0),
        "project": Cost(drawn * 4 * 25 + moving * 12, drawn * 250),
        "sort": Cost(24 * capacity * sort_passes, 0),
        "ranges": Cost(8 * capacity, 0),
        "blend": Cost(pairs * 48 + dirty * 16, pairs * 256 * 22),
        "loss": Cost(4 * near * 3 * 4 * 9, near * 3 * 4 * 75),
        "differentiate blend": Cost(pairs * 48 + dirty * 24 + moving * 36 * 8, pairs * 256 * 12 + moving * 256 * 75),
        "differentiate projection": Cost(drawn * 4 * 40 + gaussians * 4 * 31, drawn * 500),
        "differentiate decode": Cost(gaussians * 4 * (31 + 27) + anchors * 4 * 80, gaussians * (hidden * 1.9 + 200)),
        "gather": Cost(gaussians * 4 * 27 + anchors * 4 * 60, anchors * 27 * (27 * 4 + 60)),
        "Adam": Cost(anchors * 27 * 4 * 9, anchors * 27 * 20),
    }


def _best(cost: Cost, bandwidth: float, peak: float) -> float:
    return max(cost.bytes / bandwidth, cost.operations / peak)


def _row(name: str, cost: Cost, *seconds: float) -> None:
    cells = (f"{1e6 * value:.1f} |" for value in seconds)
    print(f"| {name} | {cost.bytes / 1e6:.2f} | {cost.operations / 1e6:.1f} |", *cells)


if __name__ == "__main__":
    main()
