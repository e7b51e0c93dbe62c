"""`streamlod bench launches`: what a training step asks of a GPU: launches, waits of the host, and bytes moved.

Counted on the pretend device (`tests.device`), every operation as one launch. The rasteriser is not counted: gsplat
brings its own kernels, and waits twice itself, for the numbers of Gaussians and of tiles they touch. Times are lower
bounds: launches at 5 us each, bytes at the memory bandwidth that the makers publish.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch

import streamlod.core.train.keyframe.trainer
from streamlod.core.data import linspace_split
from streamlod.core.data.dataset import Dataset
from streamlod.core.initialise import first_points
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import TrainConfig, TrainedFrame, Trainer, preset
from streamlod.core.train.keyframe.trainer import KeyframeTrainer
from streamlod.core.train.later_frame.autograd.engine import AutogradEngine
from tests.device.fixture import on_gpu
from tests.device.pretend import Counts, counted

LAUNCH_SECONDS = 5e-6
BANDWIDTH = {"H200": 4.8e12, "RTX 4070": 504e9, "RTX 4060 laptop": 256e9}  # bytes a second
SHOWN = 12  # places with the most launches
STEPS = ((KeyframeTrainer, "step"), (AutogradEngine, "step"))
# Inside a first frame's step, but in one of many: anchors come and go, and how these are rounded is measured.
REFINING = (
    (streamlod.core.train.keyframe.trainer, "precision_within"),
    (KeyframeTrainer, "_refine"),
    (KeyframeTrainer, "_order_by_effect"),
)


@dataclass(frozen=True)
class Figures:
    """Counts of a frame's training steps: without what is done in one of many, `refining`; `rest` is all else."""

    steps: int
    step: Counts
    refining: Counts
    rest: Counts


def main() -> None:
    """Train a short clip and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", default="240x136", help="of the pictures")
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--views", type=int, default=5)
    parser.add_argument("--steps", type=int, help="of the first frame; by default the preset's")
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    whole = open_synthetic(SyntheticSpec(cameras=12, frames=arguments.frames, width=width, height=height))
    clip, config = whole.select(linspace_split(whole.names, arguments.views).train), preset("live")
    if arguments.steps is not None:
        config = replace(config, keyframe=replace(config.keyframe, steps=arguments.steps))
    print("| work | times | launches | waits | MB |", *(f"{name}, ms |" for name in BANDWIDTH))
    print("| --- " * (5 + len(BANDWIDTH)) + "|")
    found = measured(clip, config)
    for frame, figures in found.items():
        _row(f"{frame}, a step", figures.steps, figures.step)
        if figures.refining.launches:
            _row(f"{frame}, refining, for each step", figures.steps, figures.refining)
        _row(f"{frame}, before and after the steps", 1, figures.rest)
    for frame, figures in found.items():
        for work, times, counts in (("a step", figures.steps, figures.step), ("the rest", 1, figures.rest)):
            for what, counter in (("launches", counts.places), ("waits", counts.waits)):
                parts = (f"{name} {count / times:.1f}" for name, count in counter.most_common(SHOWN))
                print(f"\n{frame}, {what} of {work}:", ", ".join(parts) or "none")


def measured(clip: Dataset, config: TrainConfig) -> dict[str, Figures]:
    """Train `clip` on the pretend device; figures by frame."""
    filmed = list(clip.frames())
    points = first_points(filmed[0], clip.cameras, depth_bounds=clip.depth_bounds)
    found = {}
    with pytest.MonkeyPatch.context() as patch, on_gpu(patch), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # anomaly mode, which says where a gradient comes from, warns that it is slow
        trainer = Trainer(clip.cameras, config, clip.fps, "cuda")
        with torch.autograd.detect_anomaly(check_nan=False):
            found["first frame"] = _figures(lambda: trainer.keyframe(filmed[0], points))
            for frame in filmed[1:]:
                trainer.prepare(frame)
                found[f"frame {frame.index}"] = _figures(lambda frame=frame: trainer.predict(frame))  # type: ignore[misc]
    return found


def _figures(train: Callable[[], TrainedFrame]) -> Figures:
    with pytest.MonkeyPatch.context() as patch, counted() as every:
        step, refining = _watched(patch, STEPS), _watched(patch, REFINING)
        steps = max(1, train().report.steps)
    return Figures(steps, step.less(refining), refining, every.less(step))


def _watched(patch: pytest.MonkeyPatch, functions: tuple[tuple[Any, str], ...]) -> Counts:
    """Counts of what `functions`, by their owners and names, do from now on."""
    counts = Counts()
    for owner, name in functions:
        patch.setattr(owner, name, _counting(getattr(owner, name), counts))
    return counts


def _counting(function: Callable[..., Any], counts: Counts) -> Callable[..., Any]:
    def call(*arguments: Any, **named: Any) -> Any:
        with counted(counts):
            return function(*arguments, **named)

    return call


def _row(work: str, times: int, counts: Counts) -> None:
    launches = sum(counts.launches.values()) / times
    moved, waits = counts.bytes_moved / times, sum(counts.waits.values()) / times
    best = (f"{1e3 * max(launches * LAUNCH_SECONDS, moved / speed):.2f} |" for speed in BANDWIDTH.values())
    print(f"| {work} | {times} | {launches:.0f} | {waits:.2f} | {moved / 1e6:.1f} |", *best, flush=True)


if __name__ == "__main__":
    main()
