"""Quality, size and speed of a `.slod` file against pictures that training never saw.

Everything is computed from the decoded file; how long training took comes from the figures that `streamlod train`
leaves beside it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from streamlod.client.evaluation.measure.moving import (
    MovingPixels,
    MovingScore,
    mean_moving,
    moving_figures,
    moving_score,
)
from streamlod.client.evaluation.measure.scores import PictureScore, draw, load_perception, mean_score, score
from streamlod.client.evaluation.report.output import result_folder, side_by_side
from streamlod.client.recorder import write_png
from streamlod.client.recording import RecordedFrame, decode_frames
from streamlod.core.arrays import UInt8
from streamlod.core.data import Dataset, open_dataset
from streamlod.core.errors import InputError
from streamlod.core.scene.anchors import SceneHeader
from streamlod.core.synthetic import read_spec


@dataclass(frozen=True, slots=True)
class DecodedScore:
    """One decoded frame.

    Attributes:
        frame: its number in the data set.
        picture: quality and rendering time, means over the held-out cameras.
        key_bytes, predicted_bytes: of the frame's packets.
        moving: quality on moving pixels, None where nothing is known to move.
    """

    frame: int
    picture: PictureScore
    key_bytes: int
    predicted_bytes: int
    moving: MovingScore | None


def evaluate_file(
    scene: Path,
    data: Path,
    test: tuple[str, ...],
    images: Path | None = None,
    layout: str | None = None,
    downscale: float | None = None,
    tell: Callable[[DecodedScore], None] = lambda score: None,
) -> dict[str, Any]:
    """The report: `per_frame` and `mean`, see the README for its keys.

    Args:
        test: names of the held-out cameras.
        images: folder for pictures of truth, rendering and difference side by side.
        downscale: how many times smaller than filmed the pictures are; None for the size of the training.
        tell: called after every frame.

    Raises:
        InputError: the file or the data set is unusable, or they have no frame in common.
    """
    perception = load_perception(vgg=False)
    scores: list[DecodedScore] = []
    movers: MovingPixels | None = None
    spec = read_spec(data) if data.is_dir() else None
    with closing(_pairs(scene, data, test, layout, downscale)) as pairs:
        for decoded, index, dataset, truth in pairs:
            if not scores:
                draw(decoded.scene, dataset.cameras[0])  # so that compiling is not timed
            picture, drawn = score(decoded.scene, dataset.cameras, truth, perception)
            movers = movers or MovingPixels(dataset.cameras, spec)
            moving = moving_score(drawn, truth, movers.masks(index, truth), perception.alex)
            scores.append(DecodedScore(index, picture, decoded.key_bytes, decoded.predicted_bytes, moving))
            if images is not None:
                for camera, *pair in zip(dataset.cameras, truth, drawn, strict=True):
                    write_png(result_folder(images) / f"{camera.name}_{index:05d}.png", side_by_side(*pair))
            tell(scores[-1])
    if not scores:
        raise InputError(scene, f"has no frame at the times of {data}; is it a recording of this data set?")
    return _report(scores, _training_figures(scene), scene.stat().st_size, test)


def _pairs(
    scene: Path, data: Path, test: tuple[str, ...], layout: str | None, downscale: float | None
) -> Generator[tuple[RecordedFrame, int, Dataset, UInt8], None, None]:
    """Decoded frames with the pictures [C,H,W,3] of the same time."""
    decoded = decode_frames(scene)
    current = next(decoded, None)
    if current is None:
        raise InputError(scene, "holds no packet")
    if downscale is None:
        dataset = _matching_dataset(current.scene.header, data, test, layout)
    else:
        dataset = open_dataset(data, layout=layout, downscale=downscale, cameras=test)
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


def _training_figures(scene: Path) -> dict[str, Any]:
    """What `streamlod train` left beside the file; empty without."""
    path = scene.with_name(scene.name + ".json")
    try:
        value = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read as JSON ({error})") from error
    return value if isinstance(value, dict) else {}


def _report(
    scores: list[DecodedScore], figures: dict[str, Any], size_bytes: int, test: tuple[str, ...]
) -> dict[str, Any]:
    predicted = [score.predicted_bytes for score in scores if score.predicted_bytes]
    keys = [score.key_bytes for score in scores if score.key_bytes]
    mean = mean_score([score.picture for score in scores])
    return {
        "per_frame": [
            {
                "frame": score.frame,
                "psnr": score.picture.psnr,
                "ssim": score.picture.ssim,
                "lpips": score.picture.lpips_alex,
                "bytes": score.key_bytes + score.predicted_bytes,
                "psnr_fitted": score.picture.psnr_fitted,
                **moving_figures(score.moving),
            }
            for score in scores
        ],
        "mean": {
            "psnr": mean.psnr,
            "ssim": mean.ssim,
            "lpips": mean.lpips_alex,
            "predicted_kilobytes": _mean_kilobytes(predicted),
            "keyframe_kilobytes": _mean_kilobytes(keys),
            "train_seconds": figures.get("train_seconds"),
            "first_frame_seconds": figures.get("first_frame_seconds"),
            "render_fps": 1 / max(mean.render_seconds, 1e-9),
            "psnr_fitted": mean.psnr_fitted,
            **moving_figures(mean_moving([score.moving for score in scores])),
            "largest_predicted_kilobytes": max(predicted) / 1000 if predicted else None,
        },
        "frames": len(scores),
        "cameras": list(test),
        "file_bytes": size_bytes,
    }


def _mean_kilobytes(sizes: list[int]) -> float | None:
    return float(np.mean(sizes)) / 1000 if sizes else None
