"""`streamlod bench launches`: what a training step asks of a GPU: launches, waits of the host, and bytes moved.

Counted on the pretend device (`tests.device`), where nothing is compiled: torch.compile fuses some of the launches on
a real one. The rasteriser is not counted: it brings its own few kernels. Times are lower bounds: launches at 5 us
each, bytes at the memory bandwidth that the makers publish.
"""

from __future__ import annotations

import argparse
from collections import Counter

import pytest

from core.data import linspace_split
from core.initialise import first_points
from core.synthetic import SyntheticSpec, open_synthetic
from core.train import Trainer, preset
from tests.device.fixture import on_gpu
from tests.device.pretend import Counts, counted

LAUNCH_SECONDS = 5e-6
BANDWIDTH = {"H200": 4.8e12, "RTX 4070": 504e9, "RTX 4060 laptop": 256e9}  # bytes a second
SHOWN = 6  # most frequent operations


def main() -> None:
    """Train a short clip and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", default="240x136", help="of the pictures")
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--views", type=int, default=5)
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    whole = open_synthetic(SyntheticSpec(cameras=12, frames=arguments.frames, width=width, height=height))
    clip = whole.select(linspace_split(whole.names, arguments.views).train)
    filmed = list(clip.frames())
    points = first_points(filmed[0], clip.cameras, depth_bounds=clip.depth_bounds)
    print("| stage | steps | launches a step | waits a step | MB a step |", *(f"{n}, ms |" for n in BANDWIDTH))
    print("| --- " * (5 + len(BANDWIDTH)) + "|")
    totals = []
    with pytest.MonkeyPatch.context() as patch, on_gpu(patch):
        trainer = Trainer(clip.cameras, preset("live"), clip.fps, "cuda")
        with counted() as counts:
            trainer.keyframe(filmed[0], points)
        totals.append(_row("first frame", preset("live").keyframe.steps, counts))
        for frame in filmed[1:]:
            trainer.prepare(frame)
            with counted() as counts:
                steps = trainer.predict(frame).report.steps
            totals.append(_row(f"frame {frame.index}", max(1, steps), counts))
    print(*totals, sep="\n")


def _row(stage: str, steps: int, counts: Counts) -> str:
    """Print a row of the table; returns the most frequent launches and waits in words."""
    launches, moved = sum(counts.launches.values()) / steps, counts.bytes_moved / steps
    best = (f"{1e3 * max(launches * LAUNCH_SECONDS, moved / speed):.2f} |" for speed in BANDWIDTH.values())
    waits = sum(counts.waits.values()) / steps
    print(f"| {stage} | {steps} | {launches:.0f} | {waits:.2f} | {moved / 1e6:.1f} |", *best)
    return f"{stage}: launches {_frequent(counts.launches)}; waits {_frequent(counts.waits)}"


def _frequent(counter: Counter[str]) -> str:
    return ", ".join(f"{name.removeprefix('aten.')} {count}" for name, count in counter.most_common(SHOWN))


if __name__ == "__main__":
    main()
