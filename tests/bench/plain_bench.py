"""The plain contender's settings, by default on four rows of the zoo's choosing half.

    streamlod bench plain [--data DATA] [--seconds 10] [--seeds 1] [--rows room:5:2 bright:5:2]
        [--set cell_pixels=4 --set opacity=0.1]

Prints PSNR and SSIM of the held-out camera, the number of Gaussians and the steps that fit into the CPU seconds.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from streamlod.client.evaluation.measure.footage import footage_of
from streamlod.core.data import linspace_split
from streamlod.core.metrics import psnr, ssim
from tests.bench.zoo.plain import PlainConfig, PlainGaussians, plain_views
from tests.bench.zoo.scenes import SCENES

ROWS = (("room", 5, 2.0), ("bright", 5, 2.0), ("castle", 10, 3.0), ("flame_steak_frame0", 6, 2.5))


def changed(settings: list[str]) -> PlainConfig:
    """The usual settings with each ``field=number`` of `settings` applied."""
    config = PlainConfig()
    for name, text in (setting.split("=") for setting in settings):
        if name not in {field.name for field in fields(PlainConfig)}:
            raise SystemExit(f"{name} is no setting of the plain contender")
        config = replace(config, **{name: type(getattr(config, name))(float(text))})
    return config


def row(text: str) -> tuple[str, int, float]:
    """A scene of the zoo, its number of training cameras and how many times smaller its pictures are made."""
    name, views, downscale = text.split(":")
    return name, int(views), float(downscale)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=os.environ.get("STREAMLOD_DATA"), help="folder of recordings")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--rows", nargs="+", default=ROWS, type=row, metavar="SCENE:VIEWS:DOWNSCALE")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    options = parser.parse_args()
    config, scores = changed(options.set), []
    for name, views, downscale in options.rows:
        scene = next(scene for scene in SCENES if scene.name == name)
        whole = scene.open(options.data and Path(options.data), downscale)
        if whole is None:
            print(f"{name} is skipped: it is not under the data root")
            continue
        footage = footage_of(whole, linspace_split(whole.names, views, (scene.held_out,)), frames=1)
        training, testing = next(footage.pairs())
        pictures = plain_views(training, footage.training.cameras)
        PlainGaussians(footage.points, pictures, config).train(0.1)  # compiling is not timed
        for seed in range(options.seeds):
            model = PlainGaussians(footage.points, pictures, config, seed=seed)
            steps = model.train(options.seconds)
            drawn, truth = model.picture(footage.testing.cameras[0]), testing.images[0]
            scores.append((psnr(drawn, truth), ssim(drawn, truth)))
            quality = f"{scores[-1][0]:.2f} dB {scores[-1][1]:.3f}"
            print(f"{name}, {views} views, seed {seed}: {quality}, {len(model)} Gaussians, {steps} steps", flush=True)
    if scores:
        quality = np.mean(scores, axis=0)
        print(f"mean {quality[0]:.2f} dB {quality[1]:.4f}")


if __name__ == "__main__":
    main()
