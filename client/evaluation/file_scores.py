"""Quality, size and speed of a `.slod` file against pictures that training never saw.

Everything is computed from the decoded file; how long training took comes from the figures that `streamlod train`
leaves beside it.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from client.recorder import write_png
from client.recording import RecordedFrame, decode_frames
from core.arrays import Float32, UInt8
from core.data import Dataset, open_dataset
from core.errors import BackendUnavailable, InputError
from core.metrics import psnr, ssim
from core.render.splatter import Splatter
from core.scene.anchors import SceneHeader

_log = logging.getLogger(__name__)

Distance = Callable[[UInt8, UInt8], float]


@dataclass(frozen=True, slots=True)
class FrameScore:
    """One frame, means over the held-out cameras.

    Attributes:
        psnr, ssim: of the pictures; lpips: None without its weights.
        psnr_fitted: PSNR after the best gain and offset of each channel, which takes exposure out.
        key_bytes, predicted_bytes: of the frame's packets.
        render_seconds: of one picture, expansion included.
    """

    frame: int
    psnr: float
    ssim: float
    lpips: float | None
    psnr_fitted: float
    key_bytes: int
    predicted_bytes: int
    render_seconds: float


def evaluate_file(
    scene: Path,
    data: Path,
    test: tuple[str, ...],
    images: Path | None = None,
    layout: str | None = None,
    tell: Callable[[FrameScore], None] = lambda score: None,
) -> dict[str, Any]:
    """The report: `per_frame` and `mean`, see the README for its keys.

    Args:
        test: names of the held-out cameras.
        images: folder for pictures of truth, rendering and difference side by side.
        tell: called after every frame.

    Raises:
        InputError: the file or the data set is unusable, or they have no frame in common.
    """
    lpips = _lpips()
    scores: list[FrameScore] = []
    splatter = Splatter()
    with closing(_pairs(scene, data, test, layout)) as pairs:
        for decoded, index, dataset, truth in pairs:
            if not scores:
                splatter.picture(decoded.scene, dataset.cameras[0])  # so that compiling is not timed
            scores.append(_score(splatter, decoded, index, dataset, truth, lpips, images))
            tell(scores[-1])
    if not scores:
        raise InputError(scene, f"has no frame at the times of {data}; is it a recording of this data set?")
    return _report(scores, _training_figures(scene), scene.stat().st_size, test)


def _pairs(
    scene: Path, data: Path, test: tuple[str, ...], layout: str | None
) -> Generator[tuple[RecordedFrame, int, Dataset, UInt8], None, None]:
    """Decoded frames with the pictures [C,H,W,3] of the same time."""
    decoded = decode_frames(scene)
    current = next(decoded, None)
    if current is None:
        raise InputError(scene, "holds no packet")
    dataset = _matching_dataset(current.scene.header, data, test, layout)
    half_frame = 0.5e9 / dataset.fps
    for frame in dataset.frames():
        while current is not None and current.time_ns < frame.time_ns - half_frame:
            current = next(decoded, None)
        if current is None:
            return
        if current.time_ns <= frame.time_ns + half_frame and frame.present.all():
            yield current, frame.index, dataset, frame.images


def _matching_dataset(header: SceneHeader, data: Path, test: tuple[str, ...], layout: str | None) -> Dataset:
    """The held-out cameras at the scale at which the scene was trained."""
    full = open_dataset(data, layout=layout, cameras=test)
    widths = {camera.width for camera in header.cameras}
    if len(widths) != 1:
        return full
    scale = full.cameras[0].width / widths.pop()
    return (
        full if abs(scale - 1) < 1e-3 or scale < 1 else open_dataset(data, layout=layout, downscale=scale, cameras=test)
    )


def _score(
    splatter: Splatter,
    decoded: RecordedFrame,
    index: int,
    dataset: Dataset,
    truth: UInt8,
    lpips: Distance | None,
    images: Path | None,
) -> FrameScore:
    rows: list[tuple[float, ...]] = []
    for camera, picture in zip(dataset.cameras, truth, strict=True):
        begin = time.perf_counter()
        drawn = splatter.picture(decoded.scene, camera)
        seconds = time.perf_counter() - begin
        distance = np.nan if lpips is None else lpips(drawn, picture)
        rows.append((psnr(drawn, picture), ssim(drawn, picture), distance, _fitted(drawn, picture), seconds))
        if images is not None:
            images.mkdir(parents=True, exist_ok=True)
            write_png(images / f"{camera.name}_{index:05d}.png", side_by_side(picture, drawn))
    mean = np.mean(rows, axis=0)
    return FrameScore(
        frame=index,
        psnr=float(mean[0]),
        ssim=float(mean[1]),
        lpips=None if lpips is None else float(mean[2]),
        psnr_fitted=float(mean[3]),
        key_bytes=decoded.key_bytes,
        predicted_bytes=decoded.predicted_bytes,
        render_seconds=float(mean[4]),
    )


def side_by_side(truth: UInt8, drawn: UInt8) -> UInt8:
    """[H,3W,3]: truth, rendering, and their absolute difference, four times enlarged."""
    difference = np.minimum(np.abs(truth.astype(np.int16) - drawn) * 4, 255).astype(np.uint8)
    return np.concatenate([truth, drawn, difference], axis=1)


def _fitted(drawn: UInt8, truth: UInt8) -> float:
    """PSNR after the gain and offset a channel that fit best in the least squares sense."""
    x, y = drawn.reshape(-1, 3) / 255.0, truth.reshape(-1, 3) / 255.0
    centred = x - x.mean(axis=0)
    gain = (centred * (y - y.mean(axis=0))).sum(axis=0) / np.maximum((centred**2).sum(axis=0), 1e-12)
    fitted: Float32 = np.clip(y.mean(axis=0) + gain * centred, 0, 1).astype(np.float32)
    return psnr(fitted.reshape(drawn.shape), (truth / 255.0).astype(np.float32))


def _lpips() -> Distance | None:
    try:
        from core.metrics.lpips import load_lpips

        return load_lpips().distance
    except (BackendUnavailable, ImportError) as error:
        _log.warning("LPIPS is left out: %s", error)
        return None


def _training_figures(scene: Path) -> dict[str, Any]:
    """What `streamlod train` left beside the file; empty without."""
    path = scene.with_name(scene.name + ".json")
    try:
        value = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read as JSON ({error})") from error
    return value if isinstance(value, dict) else {}


def _report(
    scores: list[FrameScore], figures: dict[str, Any], size_bytes: int, test: tuple[str, ...]
) -> dict[str, Any]:
    predicted = [score.predicted_bytes for score in scores if score.predicted_bytes]
    keys = [score.key_bytes for score in scores if score.key_bytes]
    distances = [score.lpips for score in scores if score.lpips is not None]
    return {
        "per_frame": [
            {
                "frame": score.frame,
                "psnr": score.psnr,
                "ssim": score.ssim,
                "lpips": score.lpips,
                "bytes": score.key_bytes + score.predicted_bytes,
                "psnr_fitted": score.psnr_fitted,
            }
            for score in scores
        ],
        "mean": {
            "psnr": _mean([score.psnr for score in scores]),
            "ssim": _mean([score.ssim for score in scores]),
            "lpips": _mean(distances),
            "predicted_kilobytes": _mean(predicted, 1000),
            "keyframe_kilobytes": _mean(keys, 1000),
            "train_seconds": figures.get("train_seconds"),
            "first_frame_seconds": figures.get("first_frame_seconds"),
            "render_fps": 1 / max(_mean([score.render_seconds for score in scores]) or 0.0, 1e-9),
            "psnr_fitted": _mean([score.psnr_fitted for score in scores]),
            "largest_predicted_kilobytes": max(predicted) / 1000 if predicted else None,
        },
        "frames": len(scores),
        "cameras": list(test),
        "file_bytes": size_bytes,
    }


def _mean(values: list[Any], unit: float = 1) -> float | None:
    return float(np.mean(values)) / unit if values else None
