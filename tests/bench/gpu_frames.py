"""Whole later frames by both engines on one device, for `tests.bench.gpu_day`: milliseconds, quality, bytes."""

from __future__ import annotations

from typing import Any

import numpy as np

from streamlod.client.evaluation.measure.moving import MovingPixels
from streamlod.client.evaluation.measure.scores import draw
from streamlod.codec.encoder import encode_residual
from streamlod.core.arrays import Bool, UInt8
from streamlod.core.metrics import psnr
from streamlod.core.scene.anchors import Scene
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer, preset
from streamlod.core.train.presets.settings import with_settings
from tests.core.true_points import true_points

ENGINES = ("autograd", "warp")
FRAMES = 5


def frame_figures(device: str, width: int, height: int, cameras: int, first_steps: int) -> dict[str, Any]:
    """A synthetic room's first frame trained by so many steps on `device`, then later frames by each engine.

    The time of a frame is the median without the first one, which compiles and records; of its stages likewise.
    """
    spec = SyntheticSpec(cameras=cameras, frames=FRAMES + 1, width=width, height=height)
    clip, config = open_synthetic(spec), with_settings(preset("live"), {"keyframe.steps": first_steps})
    first, *later = clip.frames()
    trainer = Trainer(clip.cameras, config, clip.fps, device)
    scene = trainer.keyframe(first, true_points(spec)).scene
    found: dict[str, Any] = {"frames": FRAMES, "anchors": scene.anchor_count}
    for engine in ENGINES:
        trainer = Trainer(clip.cameras, with_settings(config, {"predict.engine": engine}), clip.fps, device)
        trainer.resume(scene)
        moving, size_bytes, seconds = MovingPixels(clip.cameras, spec), 0, list[dict[str, float]]()
        for frame in later:
            before = trainer.scene
            done = trainer.predict(frame)
            assert done.residual is not None
            size_bytes += len(encode_residual(before, done.residual, time_ns=frame.index))
            seconds.append({**done.report.seconds, "all": done.report.total_seconds})
            found[f"{engine}: steps of the last frame"] = done.report.steps
        whole, changed = _quality(trainer.scene, clip.cameras, later[-1].images, moving.masks(FRAMES, later[-1].images))
        stages = {name: 1e3 * float(np.median([each.get(name, 0.0) for each in seconds[1:]])) for name in seconds[-1]}
        found |= {f"{engine}: ms, {name}": spent for name, spent in stages.items()}
        found |= {
            f"{engine}: PSNR at the cameras": whole,
            f"{engine}: of what moves": changed,
            f"{engine}: bytes a frame": size_bytes // FRAMES,
        }
    return found


def _quality(scene: Scene, cameras: Any, pictures: UInt8, masks: Bool | None) -> tuple[float, float]:
    """Mean PSNR of whole pictures, and of the pixels of `masks`."""
    shown = [draw(scene, camera) for camera in cameras]
    moving = [] if masks is None else list(zip(shown, pictures, masks, strict=True))
    parts = [psnr(one[mask][None], truth[mask][None]) for one, truth, mask in moving if mask.any()]
    return float(np.mean(list(map(psnr, shown, pictures)))), float(np.mean(parts)) if parts else float("nan")
