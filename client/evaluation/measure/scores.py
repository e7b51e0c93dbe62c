"""Scores of one scene's pictures against the truth of the held-out cameras."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from streamlod.core.arrays import Float32, UInt8
from streamlod.core.camera import Camera
from streamlod.core.errors import BackendUnavailable
from streamlod.core.metrics import Distance, psnr, ssim
from streamlod.core.metrics.lpips_weights import MIN_SIDE, Net
from streamlod.core.render.splatter import draw_cloud, shown_at
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand

_log = logging.getLogger(__name__)

_DRAWINGS = 3  # of each picture; the fastest counts, since other processes can only slow it down


@dataclass(frozen=True, slots=True)
class Perception:
    """The two LPIPS networks, each None without its weights."""

    alex: Distance | None = None
    vgg: Distance | None = None


@dataclass(frozen=True, slots=True)
class Metric:
    """A quality metric as reports show it: field of `PictureScore`, heading of its column, digits after the point."""

    field: str
    heading: str
    digits: int


METRICS = (
    Metric("psnr", "PSNR dB", 2),
    Metric("ssim", "SSIM", 4),
    Metric("lpips_alex", "LPIPS alex", 4),
    Metric("lpips_vgg", "LPIPS vgg", 4),
)


@dataclass(frozen=True, slots=True)
class PictureScore:
    """Means over the held-out cameras of one instant.

    Attributes:
        psnr, ssim: of the pictures, 8 bits a channel.
        psnr_fitted: PSNR after the gain and offset of each channel that fit best, which takes exposure out.
        lpips_alex, lpips_vgg: None where not measured.
        render_seconds: of one picture, expansion of the anchors included.
    """

    psnr: float
    ssim: float
    psnr_fitted: float
    lpips_alex: float | None
    lpips_vgg: float | None
    render_seconds: float


def load_perception(*, vgg: bool = True) -> Perception:
    """The LPIPS networks whose weights are installed; without `vgg`, only the fast one."""
    return Perception(_distance("alex"), _distance("vgg") if vgg else None)


def draw(scene: Scene, camera: Camera, *, highest_level: int | None = None, by_distance: bool = False) -> UInt8:
    """[H,W,3] uint8 picture of `scene` at its exposure there; arguments as in `core.scene.expand.expand`."""
    cloud = expand(scene, camera.centre, highest_level, by_distance)
    return draw_cloud(cloud, camera, scene.header.background, shown_at(scene, camera))


def score(
    scene: Scene,
    cameras: Iterable[Camera],
    truth: UInt8,
    perception: Perception | None = None,
    *,
    highest_level: int | None = None,
    by_distance: bool = False,
) -> tuple[PictureScore, list[UInt8]]:
    """Scores of `scene`, and the pictures drawn.

    Args:
        cameras: C held-out cameras; truth: [C,H,W,3] what they saw.
        perception: networks to measure LPIPS with, None to leave it out.
    """
    scores, drawn = list[PictureScore](), list[UInt8]()
    for camera, picture in zip(cameras, truth, strict=True):
        seconds = list[float]()
        for _ in range(_DRAWINGS):
            begin = time.perf_counter()
            image = draw(scene, camera, highest_level=highest_level, by_distance=by_distance)
            seconds.append(time.perf_counter() - begin)
        drawn.append(image)
        scores.append(score_picture(image, picture, perception or Perception(), min(seconds)))
    return mean_score(scores), drawn


def score_picture(drawn: UInt8, truth: UInt8, perception: Perception, render_seconds: float = 0.0) -> PictureScore:
    """Scores of one picture [H,W,3] against the true one."""
    return PictureScore(
        psnr=psnr(drawn, truth),
        ssim=ssim(drawn, truth),
        psnr_fitted=fitted_psnr(drawn, truth),
        lpips_alex=_distance_of(perception.alex, drawn, truth),
        lpips_vgg=_distance_of(perception.vgg, drawn, truth),
        render_seconds=render_seconds,
    )


def mean_score(scores: Sequence[PictureScore]) -> PictureScore:
    """The mean of each figure, None where any of the scores lacks it."""
    means: dict[str, float | None] = {}
    for name in (part.name for part in fields(PictureScore)):
        values = [getattr(score, name) for score in scores]
        means[name] = None if None in values else float(np.mean(values))
    return PictureScore(**means)  # type: ignore[arg-type]


def fitted_psnr(drawn: UInt8, truth: UInt8) -> float:
    """PSNR after the gain and offset of each channel that fit best in the least squares sense."""
    x, y = drawn.reshape(-1, 3) / 255.0, truth.reshape(-1, 3) / 255.0
    centred = x - x.mean(axis=0)
    gain = (centred * (y - y.mean(axis=0))).sum(axis=0) / np.maximum((centred**2).sum(axis=0), 1e-12)
    fitted: Float32 = np.clip(y.mean(axis=0) + gain * centred, 0, 1).astype(np.float32)
    return psnr(fitted.reshape(drawn.shape), (truth / 255.0).astype(np.float32))


def _distance_of(distance: Distance | None, drawn: UInt8, truth: UInt8) -> float | None:
    return None if distance is None or min(drawn.shape[:2]) < MIN_SIDE else distance(drawn, truth)


def _distance(net: Net) -> Distance | None:
    try:
        from streamlod.core.metrics.lpips import load_lpips  # needs torch, which a client does without

        return load_lpips(net).distance
    except (BackendUnavailable, ImportError) as error:
        _log.warning("LPIPS is left out: %s", error)
        return None
