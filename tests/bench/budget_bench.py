"""Whether a frame budget holds on a real clock: ``python -m tests.bench.budget_bench [--size 240x136 --views 5]``.

The synthetic clip stands still, bursts into motion at three times its speed, and stands still again. For each budget,
and without one: wall time of a frame from its pictures to its packet (median, 95th percentile, longest, and how many
frames were late), and the held-out PSNR before the burst, at its end, and when all has been still for a while.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from streamlod.codec.encoder import encode_residual
from streamlod.core.data import linspace_split
from streamlod.core.frames import FrameSet
from streamlod.core.initialise import first_points
from streamlod.core.metrics import psnr
from streamlod.core.render.cpu import render
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer, preset

STILL, BURST, CALM, SPEED = 5, 10, 20, 3  # frames, frames, frames, times the clip's own speed


def main() -> None:
    options = _options()
    width, height = map(int, options.size.split("x"))
    clip = open_synthetic(SyntheticSpec(frames=SPEED * BURST + 1, width=width, height=height))
    rows = [clip.names.index(name) for name in linspace_split(clip.names, options.views, ("cam00",)).train]
    cameras, filmed = tuple(clip.cameras[row] for row in rows), list(clip.frames())
    shown = [0] * STILL + list(range(SPEED, SPEED * BURST + 1, SPEED)) + [SPEED * BURST] * CALM
    training = [
        FrameSet(number, filmed[i].time_ns, filmed[i].images[rows], filmed[i].present[rows])
        for number, i in enumerate([0, *shown])
    ]
    config = preset(options.preset)
    points = first_points(training[0], cameras, depth_bounds=clip.depth_bounds)
    first = Trainer(cameras, config, clip.fps, "cpu").keyframe(training[0], points).scene

    def quality(scene: Scene, index: int) -> float:
        camera, truth = clip.cameras[0], filmed[index].images[0].astype(np.float32) / 255
        return psnr(render(expand(scene, camera.centre), camera, scene.header.background).image.clip(0, 1), truth)

    def run(milliseconds: float | None) -> None:
        trainer = Trainer(cameras, config, clip.fps, "cpu", frame_budget_ms=milliseconds)
        trainer.resume(first)
        trainer.predict(training[0])  # tells the trainer what the first frame was shown, and warms it up
        times, scores, steps = list[float](), list[float](), list[int]()
        for frame, index in zip(training[1:], shown, strict=True):
            before, begin = trainer.scene, time.perf_counter()
            result = trainer.predict(frame)
            assert result.residual is not None
            encoding = time.perf_counter()
            packet = encode_residual(before, result.residual, time_ns=0)
            end = time.perf_counter()
            trainer.sent(result, len(packet), end - encoding)
            times.append(1000 * (end - begin))
            scores.append(quality(result.scene, index))
            steps.append(result.report.steps)
        burst = slice(STILL, STILL + BURST)
        late = 0 if milliseconds is None else sum(one > milliseconds for one in times)
        print(
            f"{'no budget' if milliseconds is None else f'{milliseconds:.0f} ms':>10s} | in the burst "
            f"median {np.median(times[burst]):.0f}, 95 % {np.quantile(times[burst], 0.95):.0f}, "
            f"longest {max(times[burst]):.0f} ms and {np.mean(steps[burst]):.0f} steps a frame; of all {len(times)} "
            f"frames longest {max(times):.0f} ms, {late} late | {scores[STILL - 1]:.2f} dB before, "
            f"{scores[STILL + BURST - 1]:.2f} at its end, {scores[-1]:.2f} after {CALM} still frames",
            flush=True,
        )

    run(None)
    for milliseconds in options.budgets:
        run(milliseconds)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("budgets", type=float, nargs="*", default=[1000, 500, 250, 125], help="milliseconds a frame")
    parser.add_argument("--size", default="240x136")
    parser.add_argument("--views", type=int, default=5)
    parser.add_argument("--preset", default="live")
    return parser.parse_args()


if __name__ == "__main__":
    main()
