"""Ours, the paper's and plain Gaussians on one split of one scene: figures of a cell, and the pictures drawn."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from streamlod.client.evaluation.measure.footage import Footage
from streamlod.client.evaluation.measure.moving import MovingPixels, MovingScore, moving_figures, moving_score
from streamlod.client.evaluation.measure.places import places
from streamlod.client.evaluation.measure.scores import Perception
from streamlod.client.evaluation.systems import FirstFrames, perceived_frames, run_system
from streamlod.codec.export.spz import encode_spz
from streamlod.core.arrays import UInt8
from streamlod.core.metrics import psnr, ssim
from streamlod.core.synthetic import SyntheticSpec
from streamlod.core.train import preset
from tests.bench.zoo.plain import PlainGaussians, plain_views


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """One cell: figures for JSON; the held-out camera's last picture, [H,W,3], as it is and as it was drawn."""

    figures: dict[str, Any]
    truth: UInt8
    drawn: UInt8


@dataclass(frozen=True, slots=True, eq=False)
class Contest:
    """A split of a scene, on which all contenders are measured alike."""

    footage: Footage
    perception: Perception
    spec: SyntheticSpec | None

    def ours(self, preset_name: str, seed: int) -> Measured:
        """A preset of ours, the paper's included."""
        config = replace(preset(preset_name), seed=seed)
        run = run_system(config, self.footage, FirstFrames(), perception=self.perception, spec=self.spec)
        frames = [
            {
                **_figures(score.frame, score.picture.psnr, score.picture.ssim, score.picture.lpips_alex, score.moving),
                "cpu_seconds": score.cpu_seconds,
                "bytes": score.size.total_bytes,
            }
            for score in run.frames
        ]
        figures = {
            "points": len(self.footage.points),
            "parts": run.anchors,
            "cpu_seconds": run.frames[0].cpu_seconds,
            "frames": frames,
            "levels": [cap.picture.psnr for cap in run.caps],
            "places": run.places,
        }
        return Measured(figures, run.truth, run.drawn)

    def plain(self, cpu_seconds: list[float], seed: int) -> Measured:
        """Plain Gaussians with so many seconds for each frame, which is what ours took."""
        cameras = self.footage.testing.cameras
        movers = MovingPixels(self.footage.testing.calibrated, self.spec)
        perceived = perceived_frames(self.footage.frames)
        model: PlainGaussians | None = None
        stood: dict[str, Any] = {}
        frames: list[dict[str, Any]] = []
        size_bytes = 0
        for (training, testing), seconds in zip(self.footage.pairs(), cpu_seconds, strict=False):
            views = plain_views(training, self.footage.training.cameras)
            begin = time.process_time()
            if model is None:
                PlainGaussians(self.footage.points, views, seed=seed).train(1e-3)  # compiling is not timed
                begin = time.process_time()
                model = PlainGaussians(self.footage.points, views, seed=seed)
                model.train(seconds)
            else:
                model.follow(views, seconds)
            spent = time.process_time() - begin
            if not frames:
                present, size_bytes = views.usable, len(encode_spz(model.cloud()))
                stood = places(
                    model.picture,
                    [views.cameras[row] for row in present],
                    training.images[present],
                    self.spec,
                    space=self.footage.training.space,
                )
            drawn, truth = [model.picture(camera) for camera in cameras], testing.images
            distance = self.perception.alex if testing.index in perceived else None
            quality = [(psnr(*pair), ssim(*pair)) for pair in zip(drawn, truth, strict=True)]
            far = None if distance is None else [distance(*pair) for pair in zip(drawn, truth, strict=True)]
            moving = moving_score(drawn, truth, movers.masks(testing.index, truth), distance)
            lpips = None if far is None else float(np.mean(far))
            means = [float(value) for value in np.mean(quality, axis=0)]
            frames.append({**_figures(testing.index, means[0], means[1], lpips, moving), "cpu_seconds": spent})
        assert model is not None, "a footage has at least one frame"
        frames[0]["bytes"] = size_bytes
        figures = {
            "points": len(self.footage.points),
            "parts": len(model),
            "cpu_seconds": frames[0]["cpu_seconds"],
            "frames": frames,
            "levels": [],
            "places": stood,
        }
        return Measured(figures, truth[0], drawn[0])


def _figures(
    frame: int, quality: float, similar: float, lpips: float | None, moving: MovingScore | None
) -> dict[str, Any]:
    return {
        "frame": frame,
        "psnr": quality,
        "ssim": similar,
        "lpips": lpips,
        **moving_figures(moving),
    }
