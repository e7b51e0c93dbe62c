"""Plots of a study: what quality costs, and how it holds over a clip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from streamlod.client.evaluation.report.figures import Axis, Curve, Dot, curves, scatter
from streamlod.client.evaluation.report.pareto import pareto_front

COSTS = {
    "predicted_bytes_mean": ("KB a predicted frame", 1000.0),
    "predicted_seconds": ("training seconds a frame", 1.0),
    "render_fps": ("pictures a second", 1.0),
}


def study_plots(name: str, rows: Sequence[dict[str, Any]]) -> dict[str, str]:
    """SVG documents of one split by what they show; those without figures, as in a clip of one frame, are left out.

    Args:
        name: of the split. rows: entries of the report.
    """
    plots = {}
    for key, (label, scale) in COSTS.items():
        known = [row for row in rows if row["summary"][key] is not None]
        if not known:
            continue
        points = [(row["name"], row["summary"][key]["mean"] / scale, row["summary"]["psnr"]["mean"]) for row in known]
        plots[key] = cost_plot(name, label, points, is_speed=key == "render_fps")
    runs = {row["name"]: row["seeds"][0]["per_frame"] for row in rows}
    whole, moving = over_time(runs, "psnr"), over_time(runs, "moving_psnr")
    plots["frames"] = curves(f"{name}: PSNR by frame (first seed)", Axis("frame"), Axis("PSNR dB"), whole)
    if moving:
        title = f"{name}: PSNR of moving pixels by frame (first seed)"
        plots["moving"] = curves(title, Axis("frame"), Axis("PSNR dB"), moving)
    return plots


def cost_plot(name: str, label: str, points: Sequence[tuple[str, float, float]], *, is_speed: bool = False) -> str:
    """An SVG document of (name, cost, PSNR) points and their front; the label names the cost and its unit.

    Args:
        is_speed: whether more of it is better.
    """
    sign = -1 if is_speed else 1
    front = pareto_front([(sign * cost, quality) for _, cost, quality in points])
    dots = [Dot(*point, number in front) for number, point in enumerate(points)]
    is_logarithmic = all(dot.x > 0 for dot in dots)
    return scatter(f"{name}: PSNR against {label}", Axis(label, is_logarithmic), Axis("PSNR dB"), dots)


def over_time(runs: Mapping[str, Sequence[dict[str, Any]]], figure: str) -> list[Curve]:
    """A curve a run of `figure` over the frames where it was measured; none for a run where it never was."""
    points = {
        name: tuple((frame["frame"], frame[figure]) for frame in frames if frame[figure] is not None)
        for name, frames in runs.items()
    }
    return [Curve(name, found) for name, found in points.items() if found]


def frames_plot(name: str, frames: Sequence[dict[str, Any]]) -> str:
    """An SVG document of PSNR over the `frames` of one file: whole pictures, and moving pixels where some are known."""
    lines = over_time({"whole picture": frames}, "psnr") + over_time({"moving pixels": frames}, "moving_psnr")
    return curves(f"{name}: PSNR by frame", Axis("frame"), Axis("PSNR dB"), lines)
