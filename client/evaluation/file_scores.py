"""Quality, size and speed of a `.slod` file against pictures: of held-out cameras, and of those that trained.

Everything is computed from the decoded file; how long training took comes from the figures that `streamlod train`
leaves beside it.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Generator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from streamlod.client.evaluation.measure.elsewhere import told_elsewhere
from streamlod.client.evaluation.measure.moving import (
    MovingPixels,
    MovingScore,
    mean_moving,
    moving_figures,
    moving_score,
)
from streamlod.client.evaluation.measure.places import mean_places, places
from streamlod.client.evaluation.measure.scores import PictureScore, draw, load_perception, mean_score, score
from streamlod.client.evaluation.report.output import result_folder, side_by_side
from streamlod.client.recorder import write_png
from streamlod.client.recording import RecordedFrame, decode_frames, versions
from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera
from streamlod.core.camera.space import space_of
from streamlod.core.data import Dataset, open_dataset
from streamlod.core.data.names import listed
from streamlod.core.errors import InputError
from streamlod.core.frames import FrameSet
from streamlod.core.scene.anchors import Scene, SceneHeader
from streamlod.core.synthetic import SyntheticSpec, read_spec

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class DecodedScore:
    """One decoded frame.

    Attributes:
        frame: its number in the data set.
        picture: quality and rendering time, means over the cameras that are measured.
        key_bytes, predicted_bytes: of the frame's packets.
        moving: quality on moving pixels, None where nothing is known to move.
        places: quality at the cameras that trained and, in the first frame, beside them; as `places` has it.
    """

    frame: int
    picture: PictureScore
    key_bytes: int
    predicted_bytes: int
    moving: MovingScore | None
    places: dict[str, Any]


def evaluate_file(
    scene: Path,
    data: Path,
    test: tuple[str, ...],
    images: Path | None = None,
    layout: str | None = None,
    downscale: float | None = None,
    tell: Callable[[DecodedScore], None] = lambda score: None,
) -> dict[str, Any]:
    """The report: figures of each frame that was measured, their means, and those of each place.

    Args:
        test: names of the held-out cameras; without any, all that trained are measured.
        images: folder for pictures of truth, rendering and difference side by side.
        downscale: how many times smaller than filmed the pictures are; None for the size of the training.
        tell: called after every frame.

    Raises:
        InputError: the file or the data set is unusable, they have no frame in common, or a camera of `test` trained.
    """
    training = _training_figures(scene)
    trained = _trained_cameras(training, scene)
    leaked = sorted(set(test) & set(trained or ()))
    if leaked:
        raise InputError(
            "--test", f"{listed(leaked)} trained {scene}; hold it out by train --test, or leave --test away"
        )
    perception = load_perception(vgg=False)
    scores: list[DecodedScore] = []
    movers: MovingPixels | None = None
    spec = read_spec(data) if data.is_dir() else None
    with closing(_pairs(scene, data, test, trained, layout, downscale)) as pairs:
        for decoded, frame, dataset in pairs:
            cameras, index = dataset.cameras[: _measured(test, dataset)], frame.index
            truth = frame.images[: len(cameras)]
            if not scores:
                draw(decoded.scene, cameras[0])  # so that compiling is not timed
            picture, drawn = score(decoded.scene, cameras, truth, perception)
            movers = movers or MovingPixels(dataset.calibrated[: len(cameras)], spec)
            moving = moving_score(drawn, truth, movers.masks(index, truth), perception.alex)
            seen = dict(zip(cameras, drawn, strict=True))
            stood = _at_cameras(decoded.scene, frame, dataset, len(test), None if scores else spec, seen)
            scores.append(DecodedScore(index, picture, decoded.key_bytes, decoded.predicted_bytes, moving, stood))
            if images is not None:
                for camera, *pair in zip(cameras, truth, drawn, strict=True):
                    write_png(result_folder(images) / f"{camera.name}_{index:05d}.png", side_by_side(*pair))
            tell(scores[-1])
    if not scores:
        raise InputError(
            scene,
            f"has no frame of which {data} has a picture from each camera that is measured; is it a file of that?",
        )
    names = tuple(camera.name for camera in cameras)
    return {**_report(scores, training, scene.stat().st_size, names), "file_frames": len(versions(scene))}


def _measured(test: tuple[str, ...], dataset: Dataset) -> int:
    """How many of the cameras of `_dataset`, the first ones, are measured."""
    return len(test) or len(dataset.cameras)


def _at_cameras(
    scene: Scene,
    frame: FrameSet,
    dataset: Dataset,
    held_out: int,
    spec: SyntheticSpec | None,
    seen: Mapping[Camera, UInt8],
) -> dict[str, Any]:
    """Quality at the cameras of `dataset` that trained, those after the first `held_out`, if in this frame.

    Args:
        seen: pictures that are drawn already, by camera.
    """
    chosen = [row for row in range(held_out, len(dataset.cameras)) if frame.present[row]]
    cameras = [dataset.cameras[row] for row in chosen]

    def shown(camera: Camera) -> UInt8:
        return seen[camera] if camera in seen else draw(scene, camera)

    return places(shown, cameras, frame.images[chosen], spec, frame.index, dataset.space)


def _pairs(
    scene: Path,
    data: Path,
    test: tuple[str, ...],
    trained: tuple[str, ...] | None,
    layout: str | None,
    downscale: float | None,
) -> Generator[tuple[RecordedFrame, FrameSet, Dataset], None, None]:
    """Decoded frames with the pictures of the same time: of the held-out cameras, then of those that trained."""
    decoded = decode_frames(scene)
    current = next(decoded, None)
    if current is None:
        raise InputError(scene, "holds no packet")
    dataset = _dataset(current.scene.header, data, test, trained, layout, downscale)
    half_frame = 0.5e9 / dataset.fps
    for frame in dataset.frames():
        while current is not None and current.time_ns < frame.time_ns - half_frame:
            current = next(decoded, None)
        if current is None:
            return
        if current.time_ns <= frame.time_ns + half_frame and frame.present[: _measured(test, dataset)].all():
            yield current, frame, dataset


def _dataset(
    header: SceneHeader,
    data: Path,
    test: tuple[str, ...],
    trained: tuple[str, ...] | None,
    layout: str | None,
    downscale: float | None,
) -> Dataset:
    """The held-out cameras and those that trained, of which `data` has pictures.

    Args:
        trained: names of the latter; None, where that is not known, for all others of `header`.
        downscale: as in `evaluate_file`.
    """
    full = open_dataset(data, layout=layout, downscale=downscale or 1.0)
    rig = [camera.name for camera in header.cameras] if trained is None else trained
    names = tuple(dict.fromkeys((*test, *(name for name in rig if name in full.names))))
    if not names:
        raise InputError(data, "has none of the cameras that trained the file; name some of its own with --test")
    full = full.select(names)
    sides = {max(camera.width, camera.height) for camera in header.cameras}
    filmed = max(full.cameras[0].width, full.cameras[0].height)
    scale = filmed / sides.pop() if downscale is None and len(sides) == 1 else 1.0
    if scale >= 1 + 1e-3:
        full = open_dataset(data, layout=layout, downscale=scale).select(names)
    # Files of other versions, or of a part of this rig, have a space of their own: their cameras tell which.
    space = space_of(full.upright, header.cameras)
    placed = full.normalised() if space is None else full.placed(space)
    if elsewhere := told_elsewhere(placed.upright, header.cameras):
        _log.warning("%s: %s", data, elsewhere)
    return placed


def _training_figures(scene: Path) -> dict[str, Any]:
    """The figures that `streamlod train` left beside the file; empty where there are none."""
    path = scene.with_name(scene.name + ".json")
    try:
        value = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read as JSON ({error})") from error
    return value if isinstance(value, dict) else {}


def _trained_cameras(figures: dict[str, Any], scene: Path) -> tuple[str, ...] | None:
    """Names of the cameras that trained, of the figures beside `scene`; None where they do not say."""
    names = figures.get("trained_cameras")
    if names is None:
        return None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(scene.with_name(scene.name + ".json"), "'trained_cameras' must be a list of camera names")
    return tuple(names)


def _report(
    scores: list[DecodedScore], figures: dict[str, Any], size_bytes: int, cameras: tuple[str, ...]
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
        "places": mean_places([score.places for score in scores]),
        "frames": len(scores),
        "cameras": list(cameras),
        "file_bytes": size_bytes,
    }


def _mean_kilobytes(sizes: list[int]) -> float | None:
    return float(np.mean(sizes)) / 1000 if sizes else None
