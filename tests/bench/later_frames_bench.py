"""Later frames of the synthetic clip: quality over time, bytes and CPU time, with one choice changed at a time.

    python -m tests.bench.later_frames_bench [--frames 16 --views 5 --steps 500] [--set posterior=0.8 ...]

Every `--set` is a run of its own, with that field of `PredictConfig` changed; all start from the same first frame.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from codec.encoder import encode_residual
from codec.packet import PacketKind
from core.anchors import Scene
from core.data import linspace_split
from core.data.synthetic import SyntheticSpec, open_synthetic
from core.expand import expand
from core.frames import FrameSet
from core.initialise import first_points
from core.metrics import psnr
from core.render.cpu import render
from core.train import PredictConfig, TrainConfig, Trainer, preset


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--size", default="240x136")
    parser.add_argument("--views", type=int, default=5)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    clip = open_synthetic(SyntheticSpec(frames=options.frames, width=width, height=height))
    rows = [clip.names.index(name) for name in linspace_split(clip.names, options.views, ("cam00",)).train]
    cameras, filmed = tuple(clip.cameras[row] for row in rows), list(clip.frames())
    training = [FrameSet(f.index, f.time_ns, f.images[rows], f.present[rows]) for f in filmed]
    config = preset("live")
    config = replace(config, keyframe=replace(config.keyframe, steps=options.steps))
    points = first_points(training[0], cameras, depth_bounds=clip.depth_bounds)
    first = Trainer(cameras, config, clip.fps, "cpu").keyframe(training[0], points).scene

    def quality(scene: Scene, index: int) -> float:
        camera, truth = clip.cameras[0], filmed[index].images[0].astype(np.float32) / 255
        return psnr(render(expand(scene, camera.centre), camera, scene.header.background).image.clip(0, 1), truth)

    def run(label: str, predict: PredictConfig) -> None:
        trainer = Trainer(cameras, TrainConfig(config.model, config.keyframe, predict), clip.fps, "cpu")
        trainer.resume(first)
        scores, sizes, begin = [quality(first, 0)], list[int](), time.process_time()
        trainer.predict(training[0])  # tells the trainer what the state was shown
        for frame in training[1:]:
            before, result = trainer.scene, trainer.predict(frame)
            assert result.residual is not None
            sizes.append(len(encode_residual(before, result.residual, kind=PacketKind.PREDICTED, time_ns=0)))
            scores.append(quality(result.scene, frame.index))
        seconds = (time.process_time() - begin) / len(sizes)
        line = " ".join(f"{score:.2f}" for score in scores)
        print(f"{label:24s} {line} | {np.mean(sizes) / 1000:.1f} KB, {seconds:.2f} CPU s a frame", flush=True)

    run("live", config.predict)
    for change in options.set:
        name, value = change.split("=")
        kind = type(getattr(config.predict, name))
        run(change, replace(config.predict, **{name: kind(value)}))


if __name__ == "__main__":
    main()
