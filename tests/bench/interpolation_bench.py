"""What interpolation between states is worth: every second frame of a trained stream is taken away and made up for.

    python -m tests.bench.interpolation_bench [--kind room --speed 0 4 --frames 33]

Trains a synthetic clip frame by frame, at each `--speed` in pixels a frame (0: the kind's own pace), and draws the
frames in between with a held-out camera: as the state before (what a viewer without interpolation still shows), by
`core.scene.interpolate`, and as the state that was trained there. Tells mean PSNR on moving pixels (true motion,
dilated; docs/history/benchmarks.md) and of the whole picture.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from streamlod.client.evaluation.measure.moving import MovingPixels
from streamlod.core.arrays import Float64
from streamlod.core.metrics import psnr
from streamlod.core.render.splatter import draw_cloud
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from streamlod.core.scene.interpolate import interpolate
from streamlod.core.synthetic import SyntheticSpec
from streamlod.core.train import TrainConfig, Trainer, preset
from tests.bench.moving_bench import Clip, first_frame, open_clip

WAYS = ("state before", "interpolated", "trained")


def trained(clip: Clip, config: TrainConfig) -> list[Scene]:
    """The state of each frame."""
    first = first_frame(clip, config, None, "cpu")
    trainer = Trainer(clip.cameras, config, clip.fps, "cpu")
    trainer.resume(first)
    trainer.predict(clip.training[0])  # tells the trainer what the first frame was shown
    trainer.resume(first, keep_references=True)
    states = [first]
    for frame in clip.training[1:]:
        trainer.predict(frame)
        states.append(trainer.scene)
    return states


def measured(clip: Clip, states: list[Scene]) -> Float64:
    """[way,2] mean PSNR of the frames that were taken away: on moving pixels, of the whole picture."""
    camera, eye = clip.held_out, clip.held_out.centre
    pixels = MovingPixels((camera,), clip.spec)
    rows = []
    for index in range(1, len(states) - 1, 2):
        truth = clip.testing[index].images
        masks = pixels.masks(index, truth)
        assert masks is not None
        before, here, after = states[index - 1 : index + 2]
        clouds = (expand(before, eye), interpolate(before, after, 0.5, eye), expand(here, eye))
        drawn = [draw_cloud(cloud, camera, here.header.background) for cloud in clouds]
        rows.append([(psnr(x[masks[0]][None], truth[0][masks[0]][None]), psnr(x, truth[0])) for x in drawn])
    return np.asarray(np.mean(rows, axis=0), np.float64)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kind", default="room")
    parser.add_argument("--speed", type=float, nargs="+", default=[0.0, 4.0], help="pixels a frame; 0: own pace")
    parser.add_argument("--frames", type=int, default=33)
    parser.add_argument("--size", default="200x112")
    parser.add_argument("--views", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    config = replace(preset("live"), seed=options.seed)
    for speed in options.speed:
        spec = SyntheticSpec(kind=options.kind, frames=options.frames, width=width, height=height, speed=speed)
        clip = open_clip(spec, options.views)
        for way, (moving, whole) in zip(WAYS, measured(clip, trained(clip, config)), strict=True):
            print(f"{options.kind} at {speed:g}  {way:13s} moving {moving:.2f} dB, picture {whole:.2f} dB", flush=True)


if __name__ == "__main__":
    main()
