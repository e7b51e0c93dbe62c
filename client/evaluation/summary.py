"""From runs to figures: JSON-able values of every run, and mean and spread over the seeds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from streamlod.client.evaluation.measure.moving import MOVING_METRICS, mean_moving, moving_figures
from streamlod.client.evaluation.measure.places import PLACES, mean_figure
from streamlod.client.evaluation.measure.scores import METRICS
from streamlod.client.evaluation.measure.sizes import stream_bytes
from streamlod.client.evaluation.systems import SystemRun, TrainedScore

# The figures of a run that tables show; means over its frames unless the name says otherwise. The rendering speed is a
# median, so that another process of the machine spoils a few frames and not the figure.
FIGURES = (
    *(metric.field for metric in (*METRICS, *MOVING_METRICS)),
    *PLACES,
    "keyframe_bytes",
    "predicted_bytes_mean",
    "predicted_bytes_max",
    "stream_bytes",
    "stream_kbps",
    "shannon_keyframe_bytes",
    "shannon_predicted_bytes",
    "first_frame_seconds",
    "predicted_seconds",
    "first_frame_cpu_seconds",
    "predicted_cpu_seconds",
    "render_fps",
    "peak_bytes",
    "anchors",
    "dynamic_share",
    "motion_precision",
    "motion_recall",
)


def run_figures(run: SystemRun) -> dict[str, Any]:
    """Every figure of one run, all frames included."""
    later = [frame for frame in run.frames if frame.frame > 0]
    first = [frame for frame in run.frames if frame.frame == 0]
    pictures = [frame.picture for frame in run.frames]
    sizes = [frame.size.total_bytes for frame in later]
    motions = [frame.motion for frame in later if frame.motion is not None]
    dynamic, right, moving, found = (
        sum(getattr(motion, name) for motion in motions) for name in ("dynamic", "right", "moving", "found")
    )
    keyframe, predicted = mean(frame.size.total_bytes for frame in first), mean(sizes)
    stream = None if keyframe is None or predicted is None else stream_bytes(keyframe, predicted)
    return {
        "seed": run.seed,
        **{metric.field: mean(getattr(picture, metric.field) for picture in pictures) for metric in METRICS},
        **moving_figures(mean_moving([frame.moving for frame in run.frames])),
        **{name: mean_figure(run.places, *place) for name, place in PLACES.items()},
        "places": run.places,
        "keyframe_bytes": keyframe,
        "keyframe_level_bytes": _level_means(first),
        "predicted_bytes_mean": predicted,
        "predicted_bytes_max": max(sizes, default=None),
        "stream_bytes": stream,
        "stream_kbps": None if stream is None else stream * run.fps * 8 / 1000,
        "predicted_level_bytes": _level_means(later),
        "shannon_keyframe_bytes": mean(frame.shannon_bytes for frame in first),
        "shannon_predicted_bytes": mean(frame.shannon_bytes for frame in later),
        "first_frame_seconds": mean(frame.report.total_seconds for frame in first),
        "predicted_seconds": mean(frame.report.total_seconds for frame in later),
        "first_frame_cpu_seconds": mean(frame.cpu_seconds for frame in first),
        "predicted_cpu_seconds": mean(frame.cpu_seconds for frame in later),
        "first_frame_stages": _stage_means(first),
        "predicted_stages": _stage_means(later),
        "render_fps": 1 / max(float(np.median([picture.render_seconds for picture in pictures])), 1e-9),
        "peak_bytes": run.peak_bytes,
        "anchors": run.anchors,
        "dynamic_share": mean(frame.report.dynamic / max(frame.anchors_before, 1) for frame in later),
        "motion_precision": (right / dynamic if dynamic else 1.0) if motions else None,
        "motion_recall": (found / moving if moving else 1.0) if motions else None,
        "caps": [
            {
                "levels": cap.levels,
                "psnr": cap.picture.psnr,
                "ssim": cap.picture.ssim,
                "render_fps": 1 / max(cap.picture.render_seconds, 1e-9),
            }
            for cap in run.caps
        ],
        "per_frame": [_frame_figures(frame) for frame in run.frames],
    }


def spread(runs: Sequence[dict[str, Any]]) -> dict[str, dict[str, float] | None]:
    """Mean and sample standard deviation over the runs of each of `FIGURES`; None where nothing was measured."""
    summary: dict[str, dict[str, float] | None] = {}
    for name in FIGURES:
        values = [run[name] for run in runs if run[name] is not None]
        deviation = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
        summary[name] = {"mean": float(np.mean(values)), "spread": deviation} if values else None
    return summary


def mean(values: Iterable[float | None]) -> float | None:
    """Mean of those that were measured; None for none."""
    known = [value for value in values if value is not None and math.isfinite(value)]
    return float(np.mean(known)) if known else None


def _frame_figures(frame: TrainedScore) -> dict[str, Any]:
    return {
        "frame": frame.frame,
        **{metric.field: getattr(frame.picture, metric.field) for metric in METRICS},
        **moving_figures(frame.moving),
        "bytes": frame.size.total_bytes,
        "shannon_bytes": frame.shannon_bytes,
        "seconds": frame.report.total_seconds,
        "cpu_seconds": frame.cpu_seconds,
        "steps": frame.report.steps,
        "dynamic": frame.report.dynamic,
        "motion_precision": None if frame.motion is None else frame.motion.precision,
        "motion_recall": None if frame.motion is None else frame.motion.recall,
    }


def _level_means(frames: Sequence[TrainedScore]) -> list[float]:
    return np.mean([frame.size.level_bytes for frame in frames], axis=0).tolist() if frames else []


def _stage_means(frames: Sequence[TrainedScore]) -> dict[str, float]:
    names = dict.fromkeys(name for frame in frames for name in frame.report.seconds)
    return {name: mean(frame.report.seconds.get(name, 0.0) for frame in frames) or 0.0 for name in names}
