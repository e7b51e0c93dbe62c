"""First frame: the anchor model against plain Gaussians, same points, rasteriser, loss and CPU time.

    python -m tests.bench.first_frame_bench DATA [--views 6 --test cam00 --downscale 2 --steps 1500 --seeds 2]

Prints PSNR, SSIM, and PSNR after fitting gain and offset a channel, of the held-out camera, with the keyframe's bytes,
for the whole keyframe and cut at each level; saves the pictures. `--set features=8` and the like change one choice.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np

from streamlod.codec.encoder import encode_keyframe
from streamlod.core.arrays import Float32
from streamlod.core.data import linspace_split, open_dataset
from streamlod.core.frames import FrameSet
from streamlod.core.initialise import first_points
from streamlod.core.metrics import psnr, ssim
from streamlod.core.render.cpu import render
from streamlod.core.scene.anchors import empty_level
from streamlod.core.scene.expand import expand
from streamlod.core.train import TrainConfig, Trainer, preset
from tests.bench.zoo.plain import PlainGaussians, plain_views


def fitted(picture: Float32, truth: Float32) -> Float32:
    """`picture` with the gain and offset a channel that bring it nearest to `truth`."""
    result = picture.copy()
    for channel in range(3):
        design = np.stack([picture[..., channel].ravel(), np.ones(picture[..., channel].size)], axis=1)
        gain, offset = np.linalg.lstsq(design, truth[..., channel].ravel(), rcond=None)[0]
        result[..., channel] = picture[..., channel] * gain + offset
    return result


def changed(config: TrainConfig, settings: list[str]) -> TrainConfig:
    """`config` with each ``field=number`` of `settings` applied to its model or keyframe part."""
    model, keyframe = config.model, config.keyframe
    for name, text in (setting.split("=") for setting in settings):
        value = text == "true" if text in ("true", "false") else float(text)
        if name in {field.name for field in fields(model)}:
            model = replace(model, **{name: type(getattr(model, name))(value)})
        else:
            keyframe = replace(keyframe, **{name: type(getattr(keyframe, name))(value)})
    return replace(config, model=model, keyframe=keyframe)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data")
    parser.add_argument("--views", type=int, default=6)
    parser.add_argument("--test", default="cam00")
    parser.add_argument("--downscale", type=float, default=2)
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--preset", default="balanced")
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--no-plain", action="store_true", help="train ours alone")
    options = parser.parse_args()
    dataset = open_dataset(options.data, downscale=options.downscale)
    names = [camera.name for camera in dataset.cameras]
    rows = [names.index(name) for name in linspace_split(names, options.views, (options.test,)).train]
    frame = next(iter(dataset.frames()))
    held_out, cameras = dataset.cameras[names.index(options.test)], tuple(dataset.cameras[row] for row in rows)
    truth = frame.images[names.index(options.test)].astype(np.float32) / 255
    training = FrameSet(frame.index, frame.time_ns, frame.images[rows], frame.present[rows])
    points = first_points(training, cameras, depth_bounds=dataset.depth_bounds, dataset_points=dataset.points())

    def show(label: str, seed: int, picture: Float32, size: str, seconds: float) -> None:
        picture = picture.clip(0, 1)
        scores = (psnr(picture, truth), ssim(picture, truth), psnr(fitted(picture, truth), truth))
        print(
            f"{label:14s} seed {seed} views {len(rows)}: PSNR {scores[0]:.2f} SSIM {scores[1]:.4f} fitted "
            f"{scores[2]:.2f} size {size} CPU {seconds:.0f} s",
            flush=True,
        )
        if options.out:
            options.out.mkdir(parents=True, exist_ok=True)
            both = np.concatenate([truth, picture], axis=1)[..., ::-1]
            cv2.imwrite(str(options.out / f"{label}-{len(rows)}-{seed}.png"), (255 * both).round().astype(np.uint8))

    for seed in range(options.seeds):
        config = preset(options.preset)
        config = changed(
            replace(config, seed=seed, keyframe=replace(config.keyframe, steps=options.steps)), options.set
        )
        begin = time.process_time()
        trained = Trainer(cameras, config, dataset.fps, "cpu").keyframe(training, points)
        seconds = time.process_time() - begin
        scene = trained.scene
        for highest in reversed(range(len(scene.levels))):
            nothing = empty_level(scene.header.feature_steps.size, scene.header.gaussians_per_anchor)
            hidden = len(scene.levels) - 1 - highest
            cut = replace(scene, levels=scene.levels[: highest + 1] + (nothing,) * hidden)
            cloud = expand(scene, held_out.centre, highest)
            packet = encode_keyframe(cut, time_ns=0)
            size = f"{cut.anchor_count} anchors, {len(cloud)} Gaussians, {len(packet)} bytes"
            show(f"anchors-{highest}", seed, render(cloud, held_out, scene.header.background).image, size, seconds)
        if options.no_plain:
            continue
        plain = PlainGaussians(points, plain_views(training, cameras), seed=seed)
        plain.train(seconds)
        picture = plain.picture(held_out).astype(np.float32) / 255
        show("plain", seed, picture, f"{len(plain)} Gaussians", seconds)


if __name__ == "__main__":
    main()
