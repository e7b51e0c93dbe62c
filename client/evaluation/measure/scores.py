"""Scores of one scene's pictures against the truth of the held-out cameras."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from core.arrays import UInt8
from core.camera import Camera
from core.errors import BackendUnavailable
from core.metrics import psnr, ssim
from core.metrics.lpips import MIN_SIDE, load_lpips
from core.metrics.lpips_weights import Net
from core.render.cpu import render
from core.scene.anchors import Scene
from core.scene.expand import expand

_log = logging.getLogger(__name__)

_DRAWINGS = 3  # of each picture; the fastest counts, since other processes can only slow it down

Distance = Callable[[UInt8, UInt8], float]


@dataclass(frozen=True, slots=True)
class Perception:
    """The two LPIPS networks, each None without its weights."""

    alex: Distance | None = None
    vgg: Distance | None = None


@dataclass(frozen=True, slots=True)
class PictureScore:
    """Means over the held-out cameras of one instant.

    Attributes:
        psnr, ssim: of the pictures, 8 bits a channel.
        lpips_alex, lpips_vgg: None where not measured.
        render_seconds: of one picture, expansion of the anchors included.
    """

    psnr: float
    ssim: float
    lpips_alex: float | None
    lpips_vgg: float | None
    render_seconds: float


def load_perception() -> Perception:
    """Whichever LPIPS networks have their weights here."""
    return Perception(_distance("alex"), _distance("vgg"))


def draw(scene: Scene, camera: Camera, *, highest_level: int | None = None, by_distance: bool = False) -> UInt8:
    """[H,W,3] uint8 picture of `scene`; arguments as in `core.scene.expand.expand`."""
    cloud = expand(scene, camera.centre, highest_level, by_distance)
    image = render(cloud, camera, scene.header.background).image
    return np.asarray(np.clip(np.round(image * 255), 0, 255), np.uint8)


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
    rows, drawn = [], []
    for camera, picture in zip(cameras, truth, strict=True):
        seconds = []
        for _ in range(_DRAWINGS):
            begin = time.perf_counter()
            image = draw(scene, camera, highest_level=highest_level, by_distance=by_distance)
            seconds.append(time.perf_counter() - begin)
        drawn.append(image)
        pair = (drawn[-1], picture)
        distances = [_measured(distance, *pair) for distance in _networks(perception)]
        rows.append((psnr(*pair), ssim(*pair), *distances, min(seconds)))
    mean = np.mean(rows, axis=0)
    alex, vgg = (None if np.isnan(value) else float(value) for value in mean[2:4])
    return PictureScore(float(mean[0]), float(mean[1]), alex, vgg, float(mean[4])), drawn


def _networks(perception: Perception | None) -> tuple[Distance | None, Distance | None]:
    return (None, None) if perception is None else (perception.alex, perception.vgg)


def _measured(distance: Distance | None, picture: UInt8, truth: UInt8) -> float:
    return np.nan if distance is None or min(picture.shape[:2]) < MIN_SIDE else distance(picture, truth)


def _distance(net: Net) -> Distance | None:
    try:
        return load_lpips(net).distance
    except BackendUnavailable as error:
        _log.warning("LPIPS is left out: %s", error)
        return None
